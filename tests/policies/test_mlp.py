"""The MLP: equal to explicit matrices, and bit-identical wherever a policy stands in the stack."""

import itertools
import math

import numpy as np
import pytest

from shes.agents.mlp import MLP, RectifiedMLP, aligned_rows
from shes.errors import ConfigError


def _layers(theta, sizes):
    """Return the explicit (weights, biases) of a flat parameter vector."""
    layers, rest = [], list(theta)
    for fan_in, fan_out in itertools.pairwise(sizes):
        weights = [[rest.pop(0) for _ in range(fan_out)] for _ in range(fan_in)]
        layers.append((np.array(weights), np.array([rest.pop(0) for _ in range(fan_out)])))
    assert rest == []
    return layers


def _policies(mlp, count, seed=0):
    theta = aligned_rows(count, mlp.num_params)
    for place in range(count):
        theta[place] = mlp.initial(np.random.default_rng([seed, place]), "glorot_normal")
    return theta


def _observation(mlp, count, episodes, seed=0):
    return np.random.default_rng(seed).normal(size=(count, episodes, mlp.sizes[0])).astype(np.float32)


@pytest.mark.parametrize("hidden", [(), (6,), (7, 5), (4, 3, 8)])
def test_outputs_are_those_of_a_plain_loop_over_policies(hidden):
    mlp = MLP(9, hidden, 3)
    theta, observation = _policies(mlp, 4), _observation(mlp, 4, 5)
    outputs = mlp.act(theta, observation)
    assert outputs.shape == (4, 5, 3)
    assert outputs.dtype == np.float32
    for policy in range(4):
        for episode in range(5):
            x = observation[policy, episode].astype(float)
            for weights, biases in _layers(theta[policy].astype(float), (9, *hidden, 3)):
                x = np.tanh(x @ weights + biases)
            assert outputs[policy, episode] == pytest.approx(x, abs=1e-5)


def test_a_network_worked_out_by_hand():
    mlp = MLP(2, (1,), 1)
    theta = np.array([[0.5, -1.0, 0.25, 2.0, -0.125]], np.float32)  # weights, bias; weight, bias
    output = mlp.act(theta, np.array([[[1.0, 0.5]]], np.float32))
    assert output.item() == pytest.approx(math.tanh(2 * math.tanh(0.5 - 0.5 + 0.25) - 0.125), rel=1e-6)


@pytest.mark.parametrize("kind", [MLP, RectifiedMLP])
def test_parameters_of_zero_give_outputs_of_exactly_zero(kind):
    mlp = kind(9, (7, 5), 3)
    theta = np.zeros((2, mlp.num_params), np.float32)
    assert not mlp.act(theta, 1e6 * _observation(mlp, 2, 4)).any()


def test_acting_leaves_parameters_and_observations_as_they_were():
    mlp = MLP(3, (4,), 2)
    theta, observation = _policies(mlp, 2), _observation(mlp, 2, 3)
    before = theta.copy(), observation.copy()
    mlp.act(theta, observation)
    assert np.array_equal(theta, before[0])
    assert np.array_equal(observation, before[1])


@pytest.mark.parametrize("episodes", [1, 3, 5, 8])
@pytest.mark.parametrize("hidden", [(8,), (64, 64), (256, 256, 256)])
def test_the_bits_of_a_policy_do_not_depend_on_the_stack_it_is_in(hidden, episodes):
    count = 7
    # Ant sizes: the primitive's, and the controller's.
    for mlp in (MLP(53, hidden, 8), MLP(50, hidden, 2)):
        theta, observation = _policies(mlp, count), _observation(mlp, count, episodes)
        alone = [mlp.act(theta[i : i + 1], observation[i : i + 1])[0].tobytes() for i in range(count)]
        assert len(set(alone)) == count
        for members in ([0, 1], [3, 0, 5], [6, 5, 4, 3, 2, 1, 0], [2, 2, 2, 2]):
            stack = aligned_rows(len(members), mlp.num_params)
            stack[:] = theta[members]
            outputs = mlp.act(stack, np.ascontiguousarray(observation[members]))
            assert [row.tobytes() for row in outputs] == [alone[i] for i in members]


@pytest.mark.parametrize("hidden", [(8,), (64, 64), (256, 256, 256)])
def test_the_bits_of_an_episode_do_not_depend_on_what_the_policys_other_episodes_see(hidden):
    mlp = MLP(53, hidden, 8)
    theta, observation = _policies(mlp, 1), _observation(mlp, 1, 5)
    other = _observation(mlp, 1, 5, seed=1)
    other[0, 3] = observation[0, 3]
    assert mlp.act(theta, other)[0, 3].tobytes() == mlp.act(theta, observation)[0, 3].tobytes()


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 16), (5, 17), (4, 1000)])
def test_aligned_rows_start_on_cache_lines(rows, columns):
    array = aligned_rows(rows, columns)
    assert array.shape == (rows, columns)
    assert array.dtype == np.float32
    assert not array.any()
    assert all(array[i].ctypes.data % 64 == 0 for i in range(rows))
    array[:] = np.arange(rows)[:, None]
    assert np.array_equal(array, np.repeat(np.arange(rows), columns).reshape(rows, columns))


@pytest.mark.parametrize(("sizes", "count"), [((2, 3), 9), ((32, 64, 64, 8), 32 * 64 + 64 + 64 * 64 + 64 + 64 * 8 + 8)])
def test_parameters_are_all_weights_and_biases(sizes, count):
    mlp = MLP(sizes[0], sizes[1:-1], sizes[-1])
    assert mlp.num_params == count
    assert mlp.initial(np.random.default_rng(0)).shape == (count,)
    assert mlp.initial(np.random.default_rng(0)).dtype == np.float32


def test_initial_weights_are_glorot_normal_layer_by_layer():
    sizes = (200, 300, 100, 50)
    theta = MLP(200, (300, 100), 50).initial(np.random.default_rng(0))
    for (weights, _), fan_in, fan_out in zip(_layers(theta, sizes), sizes, sizes[1:], strict=False):
        assert weights.std() == pytest.approx(math.sqrt(2 / (fan_in + fan_out)), rel=0.03)
        assert abs(weights.mean()) < 4 * weights.std() / math.sqrt(weights.size)


def test_initial_biases_are_zero_unless_asked_for():
    for _, biases in _layers(MLP(5, (30, 20), 4).initial(np.random.default_rng(0)), (5, 30, 20, 4)):
        assert not biases.any()


def test_initial_biases_of_the_paper_count_their_own_number_as_fan():
    sizes = (3, 40, 2)
    drawn = [
        _layers(MLP(3, (40,), 2).initial(np.random.default_rng(seed), "glorot_normal"), sizes) for seed in range(500)
    ]
    for layer, std in ((0, math.sqrt(2 / 41)), (1, 0.8165)):  # 0.82 for the controller's two outputs
        assert np.std([layers[layer][1] for layers in drawn]) == pytest.approx(std, rel=0.06)


def test_the_weights_do_not_depend_on_how_the_biases_start():
    zero, drawn = (MLP(4, (6,), 2).initial(np.random.default_rng(1), name) for name in ("zero", "glorot_normal"))
    for (weights, _), (other, biases) in zip(_layers(zero, (4, 6, 2)), _layers(drawn, (4, 6, 2)), strict=True):
        assert np.array_equal(weights, other)
        assert biases.all()


@pytest.mark.parametrize("hidden", [(0,), (64, -1)])
def test_a_layer_that_is_not_positive_is_refused(hidden):
    with pytest.raises(
        ConfigError, match=r"hidden must be positive whole numbers, e\.g\. --hidden 64 64, got \(.*--hidden"
    ):
        MLP(3, hidden, 2)


@pytest.mark.parametrize("biases", ["zero", "glorot_normal"])
@pytest.mark.parametrize("hidden", [(), (6,), (7, 5)])
def test_an_output_layer_of_zeros_leaves_the_others_and_the_stream_as_they_were(hidden, biases):
    mlp, sizes = MLP(4, hidden, 3), (4, *hidden, 3)
    streams = [np.random.default_rng(1) for _ in range(2)]
    usual, zero = (
        _layers(mlp.initial(rng, biases, output), sizes)
        for rng, output in zip(streams, ("glorot_normal", "zero"), strict=True)
    )
    for (weights, bias), (others, other_bias) in zip(usual[:-1], zero[:-1], strict=True):
        assert np.array_equal(weights, others)
        assert np.array_equal(bias, other_bias)
        assert weights.all()
    assert usual[-1][0].all()
    assert not any(part.any() for part in zero[-1])
    assert streams[0].random() == streams[1].random()


def test_a_policy_with_an_output_layer_of_zeros_does_nothing():
    mlp = MLP(4, (6,), 2)
    theta = mlp.initial(np.random.default_rng(2), "glorot_normal", "zero")[None]
    assert not mlp.act(theta, _observation(mlp, 1, 5)).any()
