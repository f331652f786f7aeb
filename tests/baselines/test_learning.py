"""TD3's update and HIRO's off-policy correction against independent implementations in NumPy."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax")

import jax

from shes.agents.mlp import RectifiedMLP, normalise
from shes.baselines.learner_settings import LearnerSettings
from shes.baselines.learning import LOSSES, ControllerLearner, LevelLearner, candidates, compiled_update
from shes.baselines.levels import Level, Replay, flat
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.baselines import reference
from tests.rollout.plain_agent import outputs

pytestmark = pytest.mark.hiro

INPUTS, ACTIONS, BATCH = 5, 2, 16
HALF_RANGE = (2.0, 0.5)
RATES = {"actor_learning_rate": 0.01, "critic_learning_rate": 0.02, "target_rate": 0.1}
OWN = LearnerSettings(**RATES, batch_size=BATCH, discount=0.9)
VARIANTS = {
    "as HIRO's code": (OWN, (7, 6)),
    "raw noise": (replace(OWN, noise_unit="raw"), (7, 6)),
    "no delay": (replace(OWN, policy_delay=1), (8,)),
    "long delay": (replace(OWN, policy_delay=3, discount=0.5), (6, 5, 4)),
}


def level_of(own=OWN, hidden=(7, 6)):
    shapes = {"inputs": (INPUTS,), "action": (ACTIONS,), "reward": (), "goes_on": (), "next_inputs": (INPUTS,)}
    return Level(
        name="policy",
        actor=RectifiedMLP(INPUTS, hidden, ACTIONS),
        half_range=HALF_RANGE,
        exploration_std=np.zeros(ACTIONS),
        settings=own,
        replay=Replay(shapes=shapes, capacity=50, slack=10),
    )


def started(level, seed=0):
    """Return a state whose outputs are not all nearly zero, as those of the initial one are."""
    rng, state = np.random.default_rng(seed), level.start(np.random.default_rng(seed))
    learner = dict(state.learner)
    for name in ("actor", "critics"):
        learner[name] = reference.mixed(lambda p: p + rng.normal(0, 0.2, p.shape).astype(np.float32), learner[name])
        learner[f"target_{name}"] = learner[name]
    return replace(state, learner=learner)


def batches(count, seed=1):
    rng = np.random.default_rng(seed)
    return {
        "inputs": rng.normal(size=(count, BATCH, INPUTS)),
        "action": rng.uniform(-1, 1, (count, BATCH, ACTIONS)) * HALF_RANGE,
        "reward": rng.normal(0, 3, (count, BATCH)),
        "goes_on": rng.choice([0.0, 1.0], (count, BATCH)),
        "next_inputs": rng.normal(size=(count, BATCH, INPUTS)),
        "noise": rng.normal(0, 2, (count, BATCH, ACTIONS)),
    }


def updated(level, state, drawn):
    """Return the learner and the losses after updates with `drawn`, from a copy of `state`."""
    given = {name: array.astype(np.float32) for name, array in drawn.items()}
    return compiled_update(level.settings, level.half_range)(jax.tree.map(np.array, dict(state.learner)), given)


def reference_of(level, state):
    actor, both = (reference.mixed(np.float64, state.learner[name]) for name in ("actor", "critics"))
    critics = [reference.mixed(lambda p, i=i: p[i], both) for i in range(2)]
    return reference.TD3(actor, critics, level.settings, level.half_range)


@pytest.mark.parametrize("variant", VARIANTS)
def test_updates_are_those_of_the_reference(variant):
    level, count = level_of(*VARIANTS[variant]), 6
    state, drawn = started(level), batches(count)
    made = reference_of(level, state)
    expected = [made.update({name: array[i] for name, array in drawn.items()}) for i in range(count)]
    learner, losses = updated(level, state, drawn)
    np.testing.assert_allclose(np.stack([losses[name] for name in LOSSES], axis=1), expected, rtol=2e-4, atol=2e-5)
    for prefix in ("", "target_"):
        np.testing.assert_allclose(flat(learner[f"{prefix}actor"]), flat(getattr(made, f"{prefix}actor")), atol=2e-4)
        for found, critic in zip(flat(learner[f"{prefix}critics"]), getattr(made, f"{prefix}critics"), strict=True):
            np.testing.assert_allclose(found, flat(critic), atol=2e-4)
    assert learner["num_updates"] == count


def test_networks_start_as_in_the_published_code():
    learner = level_of(hidden=(50, 40)).start(np.random.default_rng(0)).learner
    shapes = [weights.shape for weights, _ in learner["critics"]]
    assert shapes == [(2, INPUTS + ACTIONS, 50), (2, 50 + ACTIONS, 40), (2, 40, 1)]
    for name, fans in (("actor", (INPUTS, 50)), ("critics", (INPUTS + ACTIONS, 50 + ACTIONS))):
        *hidden, last = learner[name]
        for (weights, biases), fan_in in zip(hidden, fans, strict=True):
            assert 0.95 * fan_in**-0.5 < np.abs(weights).max() <= fan_in**-0.5
            assert not np.any(biases)
        assert 0.0027 < np.abs(last[0]).max() <= 0.003
        assert 0 < np.abs(last[1]).max() <= 0.003
        assert flat(learner[f"target_{name}"]).tolist() == flat(learner[name]).tolist()
    assert not np.array_equal(*flat(learner["critics"]))


@pytest.mark.parametrize("normalise_inputs", [True, False])
def test_a_learner_draws_normalises_and_discounts(normalise_inputs):
    """An update of `LevelLearner` is that of the reference on the rows that its generator draws."""
    level = level_of(replace(OWN, normalise_inputs=normalise_inputs))
    state, rng = started(level), np.random.default_rng(4)
    statistics, clip = state.statistics, np.inf
    if normalise_inputs:
        statistics, clip = statistics.merge(10, rng.normal(0, 20, INPUTS), rng.uniform(0, 3, INPUTS)), 5.0
    learner = LevelLearner(level, replace(state, statistics=statistics))
    learner.update(2, np.random.default_rng(5))  # nothing to learn from yet
    rows = {name: array[0].astype(np.float32) for name, array in batches(1).items() if name != "noise"}
    rows["inputs"] *= 10
    learner.add(rows)
    learner.update(2, np.random.default_rng(5))

    drawing, made = np.random.default_rng(5), reference_of(level, state)
    drawn = learner.replay.sample(drawing, 2, BATCH)
    drawn["noise"] = drawing.standard_normal((2, BATCH, ACTIONS), dtype=np.float32)
    for name in ("inputs", "next_inputs"):
        drawn[name] = normalise(drawn[name], statistics.mean, 1 / statistics.std, clip)
    assert np.abs(drawn["inputs"]).max() == 5.0 if normalise_inputs else np.abs(drawn["inputs"]).max() > 5
    losses = [made.update({name: array[i] for name, array in drawn.items()}) for i in range(2)]
    after, means = learner.finish()
    np.testing.assert_allclose(flat(after.learner["actor"]), flat(made.actor), atol=1e-4)
    assert means == pytest.approx(dict(zip(LOSSES, np.nanmean(losses, axis=0), strict=True)), rel=1e-4)
    assert (after.learner["num_updates"], after.replay.size) == (2, BATCH)
    assert after.statistics.count == (10 + BATCH if normalise_inputs else 0)


def test_candidates_are_the_goal_the_change_and_eight_around_it():
    rng, limit = np.random.default_rng(3), (10.0, 0.5)
    goal, moved = np.array([[4.0, 0.1]] * 4000), np.array([[-2.0, 0.0]] * 4000)
    found = candidates(goal, moved, limit, rng)
    assert found.shape == (4000, 10, 2)
    np.testing.assert_array_equal(found[:, :2], np.stack([goal, moved], axis=1))
    drawn = found[:, 2:].reshape(-1, 2)
    np.testing.assert_allclose(np.median(drawn, axis=0), [-2, 0], atol=0.1)
    # Normal with half the half range: quartiles, because values beyond the range are clipped.
    np.testing.assert_allclose(np.quantile(drawn[:, 0], [0.25, 0.75]), -2 + 5 * np.array([-0.674, 0.674]), atol=0.15)
    assert (np.abs(drawn) <= limit).all()
    assert (np.abs(drawn[:, 1]) == 0.5).any()
    assert candidates(np.array([[4.0]]), np.array([[-20.0]]), (10.0,), rng)[0, :2].tolist() == [[4.0], [-10.0]]


def test_a_learner_corrects_every_goal_by_the_primitive_of_now():
    """Against a loop over transitions, steps and candidates with the policy that acts, in physical units."""
    settings = {"algorithm": "hiro", "hidden": (6,), "controller_interval": 4, "batch_size": 8}
    upper, lower = build_algorithm(make_config("ant-gather", "smoke", settings)).levels
    rng, limit, size = np.random.default_rng(3), np.array(lower.half_range), len(upper.half_range)
    state, inputs = started(lower), lower.actor.sizes[0]
    statistics = state.statistics.merge(20, rng.normal(0, 30, inputs), rng.uniform(20, 90, inputs))
    primitive = LevelLearner(lower, replace(state, statistics=statistics))
    learner = ControllerLearner(upper, upper.start(rng), primitive)
    rows = {name: rng.normal(0, 2, (30, *shape)).astype(np.float32) for name, shape in upper.replay.shapes.items()}
    rows["is_step"] = (np.arange(4) < rng.integers(1, 5, 30)[:, None]).astype(np.float32)
    rows["actions"] = (rng.uniform(-1, 1, rows["actions"].shape) * limit).astype(np.float32)
    learner.add(rows)
    before = learner.draw(2, np.random.default_rng(5))["action"]
    now = started(lower, seed=9)  # since then the primitive has learned
    primitive.learner = {**primitive.learner, "actor": now.learner["actor"]}
    drawn = learner.draw(2, np.random.default_rng(5))

    again, theta = np.random.default_rng(5), flat(now.learner["actor"])[None]
    expected = learner.replay.sample(again, 16)
    choices = candidates(expected["goal"], expected["change"], upper.half_range, again)
    chosen = []
    for i in range(16):
        wrong = np.zeros(10)
        for step in np.flatnonzero(expected["is_step"][i]):
            view = np.broadcast_to(expected["view"][i, step], (10, inputs - size))
            seen = np.concatenate([choices[i] - expected["moved"][i, step], view], axis=1)
            scaled = normalise(seen, statistics.mean, 1 / statistics.std, 5.0)
            action = outputs(lower.actor, theta, scaled[None])[0] * limit
            wrong += (((action - expected["actions"][i, step]) / limit) ** 2).sum(axis=1)
        chosen.append(wrong.argmin())
    np.testing.assert_allclose(drawn["action"].reshape(16, size), choices[np.arange(16), chosen], rtol=1e-5)
    assert len(set(chosen)) > 3
    assert (before != drawn["action"]).any()
    for name in ("inputs", "reward", "goes_on", "next_inputs"):
        np.testing.assert_array_equal(drawn[name].reshape(expected[name].shape), expected[name])
