"""The off-policy correction against cases worked by hand: a goal that explains the actions exactly wins."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("jax")

from shes.algorithms.hiro.correction import errors, relabelled
from shes.algorithms.hiro.goal_space import candidates
from shes.algorithms.hiro.level_learner import ControllerLearner, LevelLearner, network
from shes.es.statistics import normalise
from shes.policies.mlp import RectifiedMLP
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config

pytestmark = pytest.mark.hiro

GOAL, VIEW, ACTIONS, STEPS, BATCH = 2, 3, 2, 4, 3
NO_CLIP = np.float32(np.inf)
MEAN, INVERSE_STD = np.array([0.5, -1.0], np.float32), np.array([2.0, 0.25], np.float32)


def primitive(seed=0):
    """Return a random network, and the function that acts by it."""
    policy = RectifiedMLP(GOAL + VIEW, (16,), ACTIONS)
    theta = policy.initial(np.random.default_rng(seed), "glorot_normal")

    def act(goal, view):
        inputs = np.concatenate([(goal - MEAN) * INVERSE_STD, view]).astype(np.float32)
        return policy.act(theta[None], inputs[None, None])[0, 0]

    sizes = tuple(zip(policy.sizes[:-1], policy.sizes[1:], strict=True))
    return network(theta, sizes), act


def interval(act, goal, rng, steps=STEPS):
    """Return the coordinates' changes, views and actions of an interval in which the goal was `goal`."""
    moved = np.cumsum(rng.normal(size=(STEPS, GOAL)), axis=0) - rng.normal(size=GOAL)
    moved[0] = 0
    views = rng.normal(size=(STEPS, VIEW))
    actions, pursued = [], goal
    for step in range(STEPS):
        if step:
            pursued = moved[step - 1] + pursued - moved[step]  # h(s, g, s')
        actions.append(act(pursued, views[step]))
    is_step = np.arange(STEPS) < steps
    return moved, views, np.array(actions), is_step


def arrays(intervals):
    return [np.array(each, np.float32) for each in zip(*intervals, strict=True)]


def test_the_goal_that_explains_the_actions_exactly_wins():
    network_, act = primitive()
    rng = np.random.default_rng(1)
    goals = rng.uniform(-5, 5, (BATCH, 6, GOAL)).astype(np.float32)
    true = [2, 0, 5]
    moved, views, actions, is_step = arrays([interval(act, goals[i, true[i]], rng) for i in range(BATCH)])
    given = (network_, goals, moved, views, actions, is_step, MEAN, INVERSE_STD, NO_CLIP)
    found = np.asarray(errors(*given))
    assert found.argmin(axis=1).tolist() == true
    np.testing.assert_allclose(found.min(axis=1), 0, atol=1e-8)
    assert (np.sort(found, axis=1)[:, 1] > 1e-3).all()
    np.testing.assert_array_equal(relabelled(*given), [goals[i, true[i]] for i in range(BATCH)])


def test_the_error_is_the_sum_of_squares_over_the_steps_that_were_made():
    network_, act = primitive()
    rng = np.random.default_rng(2)
    goals = rng.uniform(-5, 5, (1, 3, GOAL)).astype(np.float32)
    played = interval(act, np.array([9.0, 9.0]), rng, steps=3)
    moved, views, actions, is_step = arrays([played])
    found = np.asarray(errors(network_, goals, moved, views, actions, is_step, MEAN, INVERSE_STD, NO_CLIP))
    expected = [
        sum(((act(goal - moved[0, t], views[0, t]) - actions[0, t]) ** 2).sum() for t in range(3)) for goal in goals[0]
    ]
    np.testing.assert_allclose(found[0], expected, rtol=1e-4)


def test_the_inputs_of_the_primitive_are_clipped():
    network_, _ = primitive()
    moved, views, actions = (np.zeros((1, 1, size), np.float32) for size in (GOAL, VIEW, ACTIONS))
    goals = np.array([[[100.0, 0.0], [1e6, 0.0], [0.5, 0.0]]], np.float32)
    one = np.ones((1, 1), np.float32)
    found = np.asarray(errors(network_, goals, moved, views, actions, one, MEAN, INVERSE_STD, np.float32(5)))[0]
    assert found[0] == found[1] != found[2]


def test_a_learner_corrects_every_goal_it_draws_by_the_primitive_of_now():
    """Against a loop over transitions, steps and candidates with the policy that acts, in physical units."""
    config = make_config("ant-gather", "smoke", {"algorithm": "hiro", "hidden": (6,), "controller_interval": 4})
    upper, lower = build_algorithm(config).levels
    rng, num_candidates = np.random.default_rng(3), 10
    size, limit = upper.actor.sizes[-1], np.array(lower.hyperparameters.half_range)
    state = lower.start(rng)
    statistics = state.statistics.merge(
        20, rng.normal(0, 30, lower.actor.sizes[0]), rng.uniform(20, 90, lower.actor.sizes[0])
    )
    primitive = LevelLearner(lower, replace(state, statistics=statistics), 0.9, 8, 2.0)
    learner = ControllerLearner(upper, upper.start(rng), 0.9, 8, 2.0, primitive, num_candidates)
    rows = {name: rng.normal(0, 2, (30, *shape)).astype(np.float32) for name, shape in upper.replay.shapes.items()}
    rows["is_step"] = (np.arange(4) < rng.integers(1, 5, 30)[:, None]).astype(np.float32)
    rows["actions"] = (rng.uniform(-1, 1, rows["actions"].shape) * limit).astype(np.float32)
    learner.add(rows)
    mean, inverse_std = statistics.mean, 1 / statistics.std
    before = learner.draw(2, np.random.default_rng(5))["action"]
    theta = lower.actor.initial(rng, "glorot_normal")  # since then the primitive has learned
    primitive.learner = primitive.learner._replace(actor=network(theta, lower.actor_shapes))
    drawn = learner.draw(2, np.random.default_rng(5))

    again = np.random.default_rng(5)
    expected = learner.replay.sample(again, 16)
    choices = candidates(expected["goal"], expected["change"], upper.hyperparameters.half_range, num_candidates, again)
    chosen = []
    for i in range(16):
        wrong = np.zeros(num_candidates)
        for j, step in itertools.product(range(num_candidates), np.flatnonzero(expected["is_step"][i])):
            inputs = np.concatenate([choices[i, j] - expected["moved"][i, step], expected["view"][i, step]])
            seen = normalise(inputs, mean, inverse_std, 2.0)[None, None].astype(np.float32)
            action = lower.actor.act(theta[None], seen)[0, 0] * limit
            wrong[j] += (((action - expected["actions"][i, step]) / limit) ** 2).sum()
        chosen.append(wrong.argmin())
    np.testing.assert_allclose(
        drawn["action"].reshape(16, size), choices[np.arange(16), chosen], rtol=1e-5, err_msg=f"{chosen}"
    )
    assert len(set(chosen)) > 3
    assert (before != drawn["action"]).any()
    for name in ("inputs", "reward", "goes_on", "next_inputs"):
        np.testing.assert_array_equal(drawn[name].reshape(expected[name].shape), expected[name])
    uncorrected = ControllerLearner(upper, upper.start(rng), 0.9, 8, 2.0, primitive, 1)
    uncorrected.add(rows)
    again = np.random.default_rng(5)
    drawn, goals = (
        uncorrected.draw(1, np.random.default_rng(5))["action"][0],
        uncorrected.replay.sample(again, 8)["goal"],
    )
    limits = np.array(upper.hyperparameters.half_range)
    np.testing.assert_allclose(drawn, np.clip(goals, -limits, limits), rtol=1e-6)
