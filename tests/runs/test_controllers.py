"""Evaluation with a controller that has learned nothing: the best of nine constant ones, and random directions."""

import importlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.algorithms.evolution.strategies import EvolutionAlgorithm
from shes.cli import main
from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.hierarchical import HierarchicalAgent
from shes.runs.evaluate import evaluate, fresh_seeds
from tests.e2e import runs
from tests.runs.recorder import recording
from tests.runs.test_evaluate import ARRAYS, same

MODULE = importlib.import_module("shes.runs.evaluate")
NAMES = ["weights at zero", *(f"{degrees} degrees" for degrees in (0, 45, 90, 135, 180, -135, -90, -45))]
MAZE = {
    "evaluation_target": (0.0, 3.0),
    "controller_interval": 5,
    "minimum_goal_distance": False,
    "goal_encoding": "unit_vector",
    "primitive_hidden": (),
    "generations": 1,
}
"""The target is to the left of the robot, which faces +x. The primitive sees the direction first."""


@pytest.fixture
def walking(monkeypatch):
    """Let the primitive of every run with the settings `MAZE` walk straight to its goal."""

    def parameters(learner, state):
        controller, primitive = original(learner, state)
        weights = np.zeros((learner.design.primitive.sizes[0] + 1, 2), np.float32)
        weights[0, 0] = weights[1, 1] = 0.5
        identity = {"mean": np.zeros_like(primitive.mean), "inverse_std": np.ones_like(primitive.inverse_std)}
        return controller, replace(primitive, theta=weights.ravel(), **identity)

    original = EvolutionAlgorithm.parameters
    monkeypatch.setattr(EvolutionAlgorithm, "parameters", parameters)


@pytest.fixture
def ends(monkeypatch):
    """Return the list of final positions [K, 2] of all evaluations."""

    def collect(results, count, primitive):
        found.append(results.final_position.reshape(-1, 2)[:count].copy())
        return original(results, count, primitive)

    original, found = MODULE._evaluation, []
    monkeypatch.setattr(MODULE, "_evaluation", collect)
    return found


@pytest.fixture
def vectors(monkeypatch):
    """Return the list of vectors to the goals [K, 2] of all decisions."""

    def choose(agent, due, rows, given, noise):
        goals = original(agent, due, rows, given, noise)
        found.append(goals - given.position[rows])
        return goals

    original, found = HierarchicalAgent.choose_goals, []
    monkeypatch.setattr(HierarchicalAgent, "choose_goals", choose)
    return found


@pytest.mark.parametrize("output", ["vector", "direction", "heading_vector", "heading_direction", "one_hot"])
def test_each_constant_controller_walks_its_way_and_the_best_one_counts(tmp_path, walking, ends, output):
    run = runs.train_tiny(tmp_path / "run", "point-maze", **MAZE, controller_output=output)
    ends.clear()
    found = evaluate(run, episodes=2, controller="constant")
    at_zero, *walked = ends
    for end, name in zip(walked, NAMES[1:], strict=True):
        assert np.hypot(*end.T).min() > 0.5
        angle = math.radians(int(name.split()[0]))
        assert end @ [-math.sin(angle), math.cos(angle)] == pytest.approx(0, abs=0.25)  # started up to 0.1 m away
        assert (end @ [math.cos(angle), math.sin(angle)] > 0.5).all()
    if output == "one_hot":  # the first of its eight directions
        assert (at_zero < -0.3).all()
    else:
        assert np.abs(at_zero).max() < 0.25
    assert found.controller == "constant: 90 degrees"
    assert np.array_equal(found.returns, evaluate(run, episodes=2, controller="constant").returns)


@pytest.mark.parametrize(
    ("scores", "returns", "best"),
    [
        ({3: 2.0, 5: 1.0}, {5: 9.0}, 3),
        ({3: 1.0, 5: 1.0}, {5: 9.0}, 5),
        ({3: 1.0, 5: 1.0}, {}, 3),
        ({}, {}, 0),
    ],
)
def test_the_best_constant_controller_has_the_highest_score_then_return(tiny_run, monkeypatch, scores, returns, best):
    def evaluation(*arguments):
        number = next(numbers)
        values = {"scores": scores.get(number, 0.0), "returns": returns.get(number, 0.0)}
        return replace(original(*arguments), **{name: np.array([value, value]) for name, value in values.items()})

    original, numbers = MODULE._evaluation, iter(range(9))
    monkeypatch.setattr(MODULE, "_evaluation", evaluation)
    assert evaluate(tiny_run, episodes=2, controller="constant").controller == f"constant: {NAMES[best]}"


@pytest.mark.parametrize("output", ["vector", "one_hot"])
def test_random_goals_are_drawn_for_every_decision_from_the_seed_of_the_episode(tmp_path, vectors, output):
    run = runs.train_tiny(tmp_path / "run", "point-maze", **MAZE, controller_output=output)
    vectors.clear()
    found = evaluate(run, episodes=3, seed=4, controller="random")
    assert found.controller == "random"
    seeds = fresh_seeds(runs.state(run), 3, seed=4)
    rngs = [np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(2,)))) for seed in seeds]
    expected = np.array([rng.uniform(0, 2 * np.pi, 4) for rng in rngs])
    x, y = np.reshape(vectors, (4, 3, 2)).T  # [episode, decision]
    angles = np.arctan2(y, x)
    difference = np.abs((angles - expected + np.pi) % (2 * np.pi) - np.pi)
    assert difference.max() < (np.pi / 8 + 1e-6 if output == "one_hot" else 1e-6)
    assert len(np.unique(expected)) == 12
    assert np.hypot(*np.concatenate(vectors).T) == pytest.approx(np.full(12, 4.0))


@pytest.mark.parametrize("controller", ["constant", "random"])
def test_workers_change_no_number_of_another_controller(tmp_path, controller):
    run = runs.train_tiny(tmp_path / "run", backend="processes", num_workers=1, episodes_per_policy=3, generations=1)
    one, two = (evaluate(run, episodes=7, num_workers=workers, controller=controller) for workers in (1, 2))
    assert same(one, two)
    assert one.controller == two.controller


@pytest.mark.parametrize(("controller", "noises"), [("trained", set()), ("random", {"decision_noise"})])
def test_no_evaluation_has_exploration_noise(tiny_run, controller, noises):
    with recording() as record:
        evaluate(tiny_run, episodes=1, num_workers=1, controller=controller)
    assert record.noises == noises


def test_the_trained_controller_is_the_default_and_other_ones_leave_it_alone(tiny_run):
    before = evaluate(tiny_run, episodes=3)
    other = evaluate(tiny_run, episodes=3, controller="random")
    assert same(before, evaluate(tiny_run, episodes=3, controller="trained"))
    assert before.controller == "trained"
    assert not same(before, other)
    assert all(np.isfinite(getattr(other, name)).all() for name in ARRAYS)


@pytest.mark.parametrize(
    ("env", "settings", "level"),
    [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {}, "primitive")],
)
def test_a_run_without_a_controller_has_none_to_replace(tmp_path, env, settings, level):
    run = runs.train_tiny(tmp_path / "run", env, generations=1, **settings)
    for controller in ("constant", "random"):
        message = rf"controller is '{controller}', but .*run has no controller \(levels: {level}\), .*'trained' is allo"
        with pytest.raises(ConfigError, match=message + r".*Omit --controller"):
            evaluate(run, episodes=1, controller=controller)
    found = evaluate(run, episodes=1)
    assert found.controller is None
    assert "controller" not in found.listing().facts


def test_an_unknown_controller_is_refused(tiny_run):
    with pytest.raises(UnknownNameError, match=r"unknown controller 'randm'.*Did you mean 'random'.*Set --controller"):
        evaluate(tiny_run, controller="randm")


def test_the_command_shows_the_controller(tiny_run, capsys):
    assert main(["evaluate", str(tiny_run), "--episodes", "2", "--controller", "constant", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["controller"].removeprefix("constant: ") in NAMES
