"""TD3's targets, losses and delayed updates against an independent implementation in NumPy."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax")

from shes.algorithms.hiro.level_learner import LevelLearner, flat, network, to_arrays, to_learner
from shes.algorithms.hiro.levels import Level, UpdateHyperparameters
from shes.algorithms.hiro.replay import Replay
from shes.algorithms.hiro.td3 import Transitions, act, compiled_update
from shes.es.statistics import normalise
from shes.policies.mlp import RectifiedMLP
from tests.algorithms.hiro import reference

pytestmark = pytest.mark.hiro

INPUTS, ACTIONS, BATCH = 5, 2, 16
OWN = UpdateHyperparameters(
    half_range=(2.0, 0.5),
    noise_std=(0.4, 0.1),
    noise_clip=(0.5, 0.12),
    actor_learning_rate=0.01,
    critic_learning_rate=0.02,
    target_rate=0.1,
    policy_delay=2,
    has_huber_loss=True,
)
VARIANTS = {
    "huber": OWN,
    "mse": replace(OWN, has_huber_loss=False),
    "no delay": replace(OWN, policy_delay=1),
    "long delay": replace(OWN, policy_delay=3),
}


def level(own=OWN, hidden=(7, 6)):
    shapes = {"inputs": (INPUTS,), "action": (ACTIONS,), "reward": (), "goes_on": (), "next_inputs": (INPUTS,)}
    replay = Replay(shapes=shapes, capacity=50, slack=10)
    actor = RectifiedMLP(INPUTS, hidden, ACTIONS)
    return Level(name="policy", actor=actor, hyperparameters=own, exploration_std=(0.1, 0.1), replay=replay)


def state_of(own_level, seed=0):
    """Return a state whose outputs are not all nearly zero, as those of the initial one are."""
    rng, state = np.random.default_rng(seed), own_level.start(np.random.default_rng(seed))
    learner = {name: array.copy() for name, array in state.learner.items()}
    for name in ("actor", "critics"):
        learner[name] += rng.normal(0, 0.2, learner[name].shape).astype(np.float32)
        learner[f"target_{name}"] = learner[name].copy()
    return replace(state, learner=learner)


def test_networks_start_as_in_the_published_code():
    own = level(hidden=(50, 40))
    state = own.start(np.random.default_rng(0))
    actor = network(state.learner["actor"], own.actor_shapes)
    critics = network(state.learner["critics"], own.critic_shapes)
    assert [np.shape(weights) for weights, _ in actor] == [(INPUTS, 50), (50, 40), (40, ACTIONS)]
    assert [np.shape(weights) for weights, _ in critics] == [
        (2, INPUTS + ACTIONS, 50),
        (2, 50 + ACTIONS, 40),
        (2, 40, 1),
    ]
    for (*hidden, last), fans in ((actor, (INPUTS, 50)), (critics, (INPUTS + ACTIONS, 50 + ACTIONS))):
        for (weights, biases), fan_in in zip(hidden, fans, strict=True):
            assert 0.95 * fan_in**-0.5 < np.abs(weights).max() <= fan_in**-0.5
            assert not np.any(biases)
        assert 0.0027 < np.abs(last[0]).max() <= 0.003
        assert 0 < np.abs(last[1]).max() <= 0.003
    assert not np.array_equal(*state.learner["critics"])
    for name in ("actor", "critics"):
        np.testing.assert_array_equal(state.learner[f"target_{name}"], state.learner[name])


def batches(count, seed=1):
    rng = np.random.default_rng(seed)
    return {
        "inputs": rng.normal(size=(count, BATCH, INPUTS)),
        "action": rng.uniform(-1, 1, (count, BATCH, ACTIONS)) * OWN.half_range,
        "reward": rng.normal(0, 3, (count, BATCH)),
        "discount": rng.choice([0.0, 0.9], (count, BATCH)),
        "next_inputs": rng.normal(size=(count, BATCH, INPUTS)),
        "noise": rng.normal(0, 2, (count, BATCH, ACTIONS)),
    }


def plain(flat_parameters, shapes):
    """Return layers in float64."""
    return [tuple(np.asarray(p, np.float64) for p in layer) for layer in network(flat_parameters, shapes)]


def reference_of(own_level, state):
    critics = [plain(each, own_level.critic_shapes) for each in state.learner["critics"]]
    return reference.TD3(plain(state.learner["actor"], own_level.actor_shapes), critics, own_level.hyperparameters)


@pytest.mark.parametrize(
    ("variant", "hidden"), [*((variant, (7, 6)) for variant in VARIANTS), ("huber", (8,)), ("huber", (6, 5, 4))]
)
def test_updates_are_those_of_the_reference(variant, hidden):
    own_level = level(VARIANTS[variant], hidden)
    state, count = state_of(own_level), 6
    made, drawn = reference_of(own_level, state), batches(count)
    expected = [made.update({name: array[i] for name, array in drawn.items()}) for i in range(count)]
    given = Transitions(**{name: array.astype(np.float32) for name, array in drawn.items()})
    learner, losses = compiled_update(own_level.hyperparameters)(to_learner(own_level, state), given)
    np.testing.assert_allclose(np.stack(losses, axis=1), expected, rtol=2e-4, atol=2e-5)
    found = to_arrays(learner)
    np.testing.assert_allclose(found["actor"], flat(made.actor), atol=2e-4)
    np.testing.assert_allclose(found["target_actor"], flat(made.target_actor), atol=2e-4)
    for i in range(2):
        np.testing.assert_allclose(found["critics"][i], flat(made.critics[i]), atol=2e-4)
        np.testing.assert_allclose(found["target_critics"][i], flat(made.target_critics[i]), atol=2e-4)
    assert int(learner.num_updates) == count


def test_the_actor_and_all_targets_wait_for_every_second_update():
    own_level = level()
    state = state_of(own_level)
    given = Transitions(**{name: array.astype(np.float32) for name, array in batches(1).items()})
    learner, losses = compiled_update(OWN)(to_learner(own_level, state), given)
    found = to_arrays(learner)
    for name in ("actor", "target_actor", "target_critics"):
        np.testing.assert_array_equal(found[name], state.learner[name])
    assert not np.array_equal(found["critics"], state.learner["critics"])
    assert np.isnan(losses.actor).all()
    learner, losses = compiled_update(OWN)(learner, given)
    found = to_arrays(learner)
    for name in ("actor", "target_actor", "target_critics"):
        assert not np.array_equal(found[name], state.learner[name])
    assert np.isfinite(losses.actor).all()


def test_updates_in_one_call_or_in_several_are_the_same():
    own_level = level()
    drawn = {name: array.astype(np.float32) for name, array in batches(4).items()}
    together, _ = compiled_update(OWN)(to_learner(own_level, state_of(own_level)), Transitions(**drawn))
    one = to_learner(own_level, state_of(own_level))
    for i in range(4):
        one, _ = compiled_update(OWN)(one, Transitions(**{name: array[i : i + 1] for name, array in drawn.items()}))
    for name, array in to_arrays(together).items():
        np.testing.assert_allclose(array, to_arrays(one)[name], atol=1e-6)


def test_the_learners_actor_is_the_one_that_acts():
    """The network in JAX and `RectifiedMLP`, by which agents act, are one function."""
    own_level = level()
    theta = state_of(own_level).learner["actor"]
    inputs = np.random.default_rng(2).normal(size=(9, INPUTS)).astype(np.float32)
    in_jax = act(network(theta, own_level.actor_shapes), inputs, np.array(OWN.half_range, np.float32))
    in_numpy = own_level.actor.act(theta[None], inputs[None])[0] * OWN.half_range
    np.testing.assert_allclose(in_jax, in_numpy, atol=1e-6)


def test_networks_become_flat_vectors_and_back():
    own_level = level()
    state = state_of(own_level)
    assert flat(network(state.learner["actor"], own_level.actor_shapes)).tolist() == state.learner["actor"].tolist()
    critics = network(state.learner["critics"], own_level.critic_shapes)
    assert [weights.shape for weights, _ in critics] == [(2, 7, 7), (2, 9, 6), (2, 6, 1)]
    np.testing.assert_array_equal(flat(critics), state.learner["critics"])
    assert {name: array.tolist() for name, array in to_arrays(to_learner(own_level, state)).items()} == {
        name: array.tolist() for name, array in state.learner.items()
    }


def test_a_learner_draws_normalises_and_discounts():
    """An update of `LevelLearner` is that of the reference on the rows that its generator draws."""
    own_level = level()
    state, rng = state_of(own_level), np.random.default_rng(4)
    statistics = state.statistics.merge(10, rng.normal(0, 20, INPUTS), rng.uniform(50, 90, INPUTS))
    learner = LevelLearner(own_level, replace(state, statistics=statistics), 0.9, BATCH, 1.5)
    assert not learner.can_learn
    rows = {
        name: array[0].astype(np.float32) for name, array in batches(1).items() if name not in ("discount", "noise")
    }
    learner.add({**rows, "goes_on": np.arange(BATCH, dtype=np.float32) % 2})
    assert learner.can_learn
    learner.update(2, np.random.default_rng(5))

    drawing, made = np.random.default_rng(5), reference_of(own_level, state)
    drawn = learner.replay.sample(drawing, 2, BATCH)
    noise = drawing.standard_normal((2, BATCH, ACTIONS), dtype=np.float32)
    for i in range(2):
        seen, following = (
            normalise(drawn[name][i], statistics.mean, 1 / statistics.std, 1.5) for name in ("inputs", "next_inputs")
        )
        assert np.abs(seen).max() == 1.5
        expected = made.update(
            {
                "inputs": seen,
                "action": drawn["action"][i],
                "reward": drawn["reward"][i],
                "discount": 0.9 * drawn["goes_on"][i],
                "next_inputs": following,
                "noise": noise[i],
            }
        )
    np.testing.assert_allclose(learner.parameters.theta, flat(made.actor), atol=1e-4)
    after, losses = learner.finish(normalises=True)
    assert (after.num_updates, after.replay.size, after.statistics.count) == (2, BATCH, 10 + BATCH)
    assert losses["actor_loss"] == pytest.approx(expected[1], rel=1e-4)
    assert learner.finish(normalises=False)[0].statistics.count == 10
