"""Equivariant networks: transformed inputs give transformed outputs, for any signed permutations."""

import numpy as np
import pytest

from shes.agents.equivariant import EquivariantMLP, sector_actions
from shes.agents.goals import SectorOutput, VectorOutput
from shes.agents.mlp import MLP
from tests.rollout import plain_agent

QUARTER_TURN = (np.array([1, 0]), np.array([-1.0, 1.0]))  # (x, y) -> (-y, x)
MIRROR = (np.array([0, 1]), np.array([1.0, -1.0]))
REGULAR = tuple((np.array(source), np.ones(4)) for source in ([3, 0, 1, 2], [0, 3, 2, 1]))
SCALAR, CHIRAL = [(np.zeros(1, int), np.array([sign])) for sign in (1.0, -1.0)]
NETWORKS = {
    "ring": [sector_actions(10, count) for count in (5, 8, 1)],
    "deep ring": [sector_actions(6, count) for count in (3, 4, 2, 1)],
    "odd ring": [sector_actions(5, count) for count in (4, 1)],
    "vector to vector": [(QUARTER_TURN, MIRROR), REGULAR, REGULAR, (QUARTER_TURN, MIRROR)],
    "one mirror": [(MIRROR,), (MIRROR,), (CHIRAL,)],
}


def transform(action, values):
    source, sign = action
    return sign.astype(np.float32) * values[..., source]


@pytest.mark.parametrize("actions", NETWORKS.values(), ids=NETWORKS)
def test_transformed_inputs_give_transformed_outputs(actions):
    network, rng = EquivariantMLP(actions), np.random.default_rng(0)
    theta = rng.normal(0, 0.7, (3, network.num_params)).astype(np.float32)
    seen = rng.normal(0, 1, (3, 5, network.sizes[0])).astype(np.float32)
    plain = plain_agent.outputs(network, theta, seen)
    for inputs, outputs in zip(actions[0], actions[-1], strict=True):
        turned = plain_agent.outputs(network, theta, transform(inputs, seen))
        np.testing.assert_allclose(turned, transform(outputs, plain), atol=2e-6)
        assert np.abs(turned - plain).max() > 0.01


def test_a_ring_has_the_parameters_of_a_symmetric_convolution():
    """Of a kernel of five sectors there are three distances, of ten there are six; and a bias per channel."""
    assert EquivariantMLP(NETWORKS["odd ring"]).num_params == 4 * 3 + 1
    assert EquivariantMLP(NETWORKS["ring"]).num_params == 5 * 8 * 6 + 8 + 8 * 6 + 1


def test_weights_that_the_symmetry_forbids_are_zero():
    network = EquivariantMLP([(MIRROR,), (CHIRAL,)])  # straight ahead says nothing about left and right
    assert network.num_params == 1
    seen = np.array([[[1, 0], [1, 1]]], np.float32)
    assert plain_agent.outputs(network, np.ones((1, 1), np.float32), seen).ravel() == pytest.approx([0.0, np.tanh(1)])


def test_initial_parameters_are_weights_of_an_mlp_of_that_size():
    network = EquivariantMLP(NETWORKS["ring"])
    sources = (network, MLP(50, (80,), 10))
    theta, full = (each.initial(np.random.default_rng(2), output_weights="zero") for each in sources)
    weights = network.expand(theta[None])
    assert set(weights[0].tolist()) <= set(full.tolist())
    (first, _), (last, _) = network.layers(weights)
    assert first.std() == pytest.approx(np.sqrt(2 / 130), rel=0.15)
    assert not last.any()


@pytest.mark.parametrize("name", ["ring", "vector to vector"])
def test_pooled_sums_are_averages_over_exchanged_inputs(name):
    actions, network = NETWORKS[name], EquivariantMLP(NETWORKS[name])
    total, squares = np.random.default_rng(3).normal(size=(2, network.sizes[0]))
    pooled, pooled_squares = total.copy(), squares.copy()
    network.pool(pooled, pooled_squares)
    if name == "ring":
        assert pooled == pytest.approx(np.repeat(total.reshape(5, 10).mean(axis=1), 10))
    else:
        assert pooled.tolist() == [0.0, 0.0]  # the mean of a vector and all its turns
    for action in actions[0]:
        assert transform(action, pooled) == pytest.approx(pooled)
        assert pooled_squares[action[0]] == pytest.approx(pooled_squares)
    assert pooled_squares.sum() == pytest.approx(squares.sum())


def test_outputs_along_a_sector_give_a_goal_at_full_distance():
    """Equal outputs cancel; that goals turn with the outputs is in `rollout/test_agent.py`."""
    along = np.cos(-np.pi + (np.arange(10) + 0.5) * np.pi / 5)
    goals = SectorOutput(10, VectorOutput()).vector(np.stack([along, np.ones(10)]), np.zeros(2), 4.0)
    np.testing.assert_allclose(goals, [[4.0, 0.0], [0.0, 0.0]], atol=1e-6)
