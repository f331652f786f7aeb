"""The MLP: equal to explicit matrices, and bit-identical wherever a policy stands in the stack."""

import itertools

import numpy as np
import pytest

from shes.agents.mlp import MLP, RectifiedMLP, aligned_rows
from tests.rollout import plain_agent


def _policies(mlp, count):
    theta = aligned_rows(count, mlp.num_params)
    for place in range(count):
        theta[place] = mlp.initial(np.random.default_rng([0, place]), "glorot_normal")
    return theta


@pytest.mark.parametrize("kind", [MLP, RectifiedMLP])
@pytest.mark.parametrize("hidden", [(), (6,), (4, 3, 8)])
def test_outputs_equal_a_plain_loop_over_policies(hidden, kind):
    mlp, activate = kind(9, hidden, 3), np.tanh if kind is MLP else lambda x: np.maximum(x, 0)
    theta, observation = _policies(mlp, 4), np.random.default_rng(0).normal(size=(4, 5, 9)).astype(np.float32)
    theta.flags.writeable = observation.flags.writeable = False
    outputs = plain_agent.outputs(mlp, theta, observation)
    assert (outputs.shape, outputs.dtype) == ((4, 5, 3), np.float32)
    for policy, episode in np.ndindex(4, 5):
        expected = plain_agent.network(mlp, theta[policy], observation[policy, episode], activate)
        assert outputs[policy, episode] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("episodes", [1, 3, 8])
@pytest.mark.parametrize("hidden", [(8,), (64, 64), (256, 256, 256)])
def test_outputs_are_bit_identical_in_any_company(hidden, episodes):
    """Of other policies in the stack, and of other episodes of the policy."""
    for mlp in (MLP(53, hidden, 8), MLP(50, hidden, 2)):  # the ant's primitive and controller
        theta, rng = _policies(mlp, 7), np.random.default_rng(0)
        assert all(row.ctypes.data % 64 == 0 for row in theta)
        observation, other = rng.normal(size=(2, 7, episodes, mlp.sizes[0])).astype(np.float32)
        alone = [plain_agent.outputs(mlp, theta[i : i + 1], observation[i : i + 1])[0].tobytes() for i in range(7)]
        assert len(set(alone)) == 7
        for members in ([0, 1], [3, 0, 5], [6, 5, 4, 3, 2, 1, 0], [2, 2, 2, 2]):
            stack = aligned_rows(len(members), mlp.num_params)
            stack[:] = theta[members]
            outputs = plain_agent.outputs(mlp, stack, np.ascontiguousarray(observation[members]))
            assert [row.tobytes() for row in outputs] == [alone[i] for i in members]
        other[:, -1] = observation[:, -1]
        assert (
            plain_agent.outputs(mlp, theta, other)[:, -1].tobytes()
            == plain_agent.outputs(mlp, theta, observation)[:, -1].tobytes()
        )


def test_initial_parameters_are_glorot_normal_layer_by_layer():
    """A bias vector's fan is its own length, as in the authors' code."""
    mlp, sums = MLP(8, (12, 20), 10), []
    for seed in range(300):
        theta = mlp.initial(np.random.default_rng(seed), "glorot_normal")
        assert (theta.shape, theta.dtype) == ((mlp.num_params,), np.float32)
        sums.append([(part**2).mean() for layer in mlp.layers(theta[None]) for part in layer])
    expected = [2 / fan for n, m in itertools.pairwise(mlp.sizes) for fan in (n + m, 1 + m)]
    assert np.mean(sums, axis=0) == pytest.approx(expected, rel=0.1)
