"""Evaluation: fresh episodes of the mean policies, with the trained controller or one that has learned nothing."""

import importlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.agents.goal_agent import GoalAgent
from shes.cli import main
from shes.errors import CheckpointError, ConfigError, PolicyError, RunFolderError, UnknownNameError
from shes.evolution.strategies import EvolutionAlgorithm
from shes.runs.evaluate import Evaluation, evaluate, evaluation_seeds, fresh_seeds
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.streams import Purpose
from tests.e2e import runs
from tests.runs.recorder import recording

ARRAYS = ("scores", "returns", "primitive_returns", "goals_reached", "successes", "steps", "diverged")
MODULE = importlib.import_module("shes.runs.evaluate")


def same(one, other):
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


@pytest.fixture(scope="module")
def threes(tmp_path_factory):
    """A run with three episodes per policy, so that blocks of evaluation are not full."""
    settings = {"episodes_per_policy": 3, "backend": "processes", "num_workers": 1, "generations": 1}
    return runs.train_tiny(tmp_path_factory.mktemp("threes") / "run", **settings)


@pytest.mark.parametrize("controller", ["trained", "constant", "random"])
def test_workers_change_no_number(threes, controller):
    one, two = (evaluate(threes, episodes=7, num_workers=workers, controller=controller) for workers in (1, 2))
    assert same(one, two)
    assert one.controller == two.controller
    assert one.scores.shape == (7,)


@pytest.mark.parametrize("backend", ["mpi", "ray"])
def test_a_run_of_a_cluster_is_evaluated_on_this_machine(run_copy, tiny_run, monkeypatch, backend):
    monkeypatch.setenv("RAY_ADDRESS", "gone:6379")
    record = json.loads((run_copy / "config.json").read_text())
    record["config"]["workers"]["backend"] = backend
    (run_copy / "config.json").write_text(json.dumps(record))
    assert same(evaluate(run_copy, episodes=4, num_workers=1), evaluate(tiny_run, episodes=4, num_workers=1))


def test_fewer_episodes_are_the_first_of_more_and_a_seed_chooses_others(tiny_run):
    few, many, one, again = (
        evaluate(tiny_run, episodes=episodes, num_workers=1, seed=seed)
        for episodes, seed in ((3, None), (5, None), (5, 1), (5, 1))
    )
    assert all(np.array_equal(getattr(few, name), getattr(many, name)[:3]) for name in ARRAYS)
    assert same(one, again)
    assert not same(many, one)


def test_fresh_episodes_are_none_of_those_that_chose_the_checkpoint(tiny_run):
    state = runs.state(tiny_run, "last")
    chosen = [evaluation_seeds(state.seed, generation, 50) for generation in (0, 2, state.generation)]
    fresh = fresh_seeds(state, 50)
    assert fresh == evaluation_seeds(state.seed, state.generation, 50, Purpose.FRESH_EPISODES)
    own = fresh_seeds(state, 50, seed=3)
    assert own == fresh_seeds(runs.state(tiny_run, "0"), 50, seed=3)  # whatever the checkpoint
    assert len({seed for each in (*chosen, fresh, own) for seed in each}) == 250


def test_targets_of_training_may_be_asked_for(tmp_path):
    # Training's target is far: nobody comes nearer than 200 m to it, or further than 50 m from evaluation's.
    run = runs.train_tiny(tmp_path / "run", "point-maze", target=(0.0, 300.0), evaluation_target=(0.0, 1.0))
    one, other = (evaluate(run, episodes=4, num_workers=1, targets=targets) for targets in ("evaluation", "training"))
    assert other.returns.max() < 20 * -200
    assert one.returns.min() > 20 * -50


def test_the_targets_of_training_come_without_its_falls(tmp_path):
    run = runs.train_tiny(tmp_path / "run", "ant-maze", max_tilt=0.5)
    assert np.mean(read_csv(run / "progress.csv")["terminated_rate"]) > 0.5
    found = evaluate(run, episodes=3, num_workers=1, targets="training")
    assert set(found.steps) == {RunFolder(run).read_config().episodes.horizon}


def test_checkpoints_are_evaluated_apart_and_nothing_is_written(tiny_run):
    before = {path: path.read_bytes() for path in tiny_run.rglob("*") if path.is_file()}
    first, last, fourth = (evaluate(tiny_run, episodes=4, checkpoint=name) for name in ("0", "last", "4"))
    assert not same(first, last)
    assert same(fourth, last)
    assert {path: path.read_bytes() for path in tiny_run.rglob("*") if path.is_file()} == before


def test_a_summary_holds_means_and_deviations():
    found = Evaluation(
        scores=np.array([0.0, 4.0]),
        returns=np.array([-1.0, 3.0]),
        primitive_returns=np.array([5.0, 6.0]),
        goals_reached=np.array([2.0, 1.0]),
        successes=np.array([0.0, 1.0]),
        steps=np.array([10.0, 20.0]),
        diverged=np.array([1.0, 0.0]),
    )
    assert found.summary() == {
        "episodes": 2,
        "score_mean": 2.0,
        "score_std": 2.0,
        "return_mean": 1.0,
        "return_std": 2.0,
        "primitive_return_mean": 5.5,
        "goals_reached_mean": 1.5,
        "success_rate": 0.5,
        "episode_steps_mean": 15.0,
        "diverged_episodes": 1,
    }


@pytest.mark.parametrize(
    ("env", "settings", "level"),
    [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {"controller_interval": 7}, "primitive")],
)
def test_a_run_of_one_level_is_evaluated_by_what_it_has(tmp_path, env, settings, level):
    path = runs.train_tiny(tmp_path / "run", env, generations=1, evaluation_horizon=30, **settings)
    found = evaluate(path, episodes=3, num_workers=1)
    of_primitive = {name for name in found.summary() if name.startswith(("primitive", "goals"))}
    assert of_primitive == ({"primitive_return_mean", "goals_reached_mean"} if level == "primitive" else set())
    if level == "primitive":  # the task pays by the same formula, in code of its own
        np.testing.assert_allclose(found.primitive_returns, found.returns, rtol=1e-9)
    table = read_csv(path / "evaluation.csv")
    assert set(found.summary()) == set(table) - {"generation", "env_steps", "wall_time_s", "process_time_s"}
    assert table["episode_steps_mean"] == [30]
    assert read_csv(path / "progress.csv")["episode_steps_mean"] == [20]
    assert found.controller is None
    assert "controller" not in found.listing().facts
    message = (
        rf"controller is 'random', but .*run has no controller \(levels: {level}\), .*'trained' is allowed.*Omit --c"
    )
    with pytest.raises(ConfigError, match=message):
        evaluate(path, episodes=1, controller="random")


# What cannot be.


def test_what_the_workers_tell_is_a_warning(tiny_run, monkeypatch, caplog):
    def build(*arguments):
        backend = original(*arguments)
        run = backend.map
        monkeypatch.setattr(backend, "map", lambda tasks: (backend.on_event("worker 7 is silent"), run(tasks))[1])
        return backend

    original = MODULE.build_backend
    monkeypatch.setattr(MODULE, "build_backend", build)
    evaluate(tiny_run, episodes=2, num_workers=1)
    assert [(each.levelname, each.message) for each in caplog.records] == [("WARNING", "worker 7 is silent")]


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"checkpoint": "first"}, CheckpointError, r"there is no checkpoint .*There are: best, generation_000000, "),
        ({"controller": "randm"}, UnknownNameError, r"unknown controller 'randm'.*Did you mean 'random'.*Set --contr"),
        ({"targets": "train"}, UnknownNameError, r"unknown targets 'train'.*Did you mean 'training'.*Set --targets"),
        ({"episodes": 0}, ConfigError, "episodes must be a whole number of at least 1, got 0"),
        ({"njmax": 2}, ConfigError, "njmax is 2, but the CPU's physics has no fixed buffers"),
    ],
)
def test_wrong_arguments_are_refused(tiny_run, tmp_path, given, error, message):
    with pytest.raises(error, match=message):
        evaluate(tiny_run, **given)
    with pytest.raises(RunFolderError, match="is not a run folder"):
        evaluate(tmp_path)


def test_a_policy_that_returns_nan_is_an_error(run_copy, monkeypatch):
    """Where it comes from nobody knows: the checkpoint itself holds none."""

    def parameters(learner, state):
        controller, primitive = original(learner, state)
        return controller, replace(primitive, theta=np.full_like(primitive.theta, np.nan))

    original = EvolutionAlgorithm.parameters
    monkeypatch.setattr(EvolutionAlgorithm, "parameters", parameters)
    with pytest.raises(PolicyError, match=r"returned NaN or infinity at step 0 \(parameters of its primitive"):
        evaluate(run_copy, episodes=2)


# Controllers that have learned nothing.

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
def vectors(monkeypatch):
    """Return the list of vectors to the goals [K, 2] of all decisions."""

    def act(agent, observation, position, heading, **noise):
        is_due = np.repeat(agent.clock % agent.design.controller_interval == 0, agent.rows_per_lane)
        controls = original(agent, observation, position, heading, **noise)
        if is_due.any():
            found.append((agent.goal - position)[is_due])
        return controls

    original, found = GoalAgent.act, []
    monkeypatch.setattr(GoalAgent, "act", act)
    return found


@pytest.mark.parametrize("output", ["vector", "direction", "heading_vector", "heading_direction", "one_hot"])
def test_the_best_of_nine_constant_controllers_counts(tmp_path, walking, vectors, output):
    run = runs.train_tiny(tmp_path / "run", "point-maze", **MAZE, controller_output=output)
    vectors.clear()
    found = evaluate(run, episodes=2, controller="constant")
    assert found.controller == "constant: 90 degrees"
    ways = np.reshape(vectors, (9, 4, 2, 2))  # [controller, decision, episode, axis]
    if output.startswith("heading"):  # the point turns
        ways = ways[:, :1]
    angles = np.arctan2(ways[..., 1], ways[..., 0])
    for own, name in zip(angles[1:], NAMES[1:], strict=True):
        difference = own - math.radians(int(name.split()[0]))
        assert np.abs((difference + np.pi) % (2 * np.pi) - np.pi).max() < 0.2  # the heading is up to 0.1 rad off
    if output in ("vector", "heading_vector"):
        assert np.abs(ways[0]).max() < 1e-6
    elif output == "one_hot":  # the first of its eight directions
        assert (ways[0] < 0).all()


@pytest.mark.parametrize(
    ("scores", "returns", "best"),
    [({3: 2.0, 5: 1.0}, {5: 9.0}, 3), ({3: 1.0, 5: 1.0}, {5: 9.0}, 5), ({3: 1.0, 5: 1.0}, {}, 3), ({}, {}, 0)],
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
    assert evaluate(run, episodes=3, seed=4, controller="random").controller == "random"
    seeds = fresh_seeds(runs.state(run), 3, seed=4)
    rngs = [np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(2,)))) for seed in seeds]
    expected = np.array([rng.uniform(0, 2 * np.pi, 4) for rng in rngs])
    x, y = np.reshape(vectors, (4, 3, 2)).T  # [episode, decision]
    difference = np.abs((np.arctan2(y, x) - expected + np.pi) % (2 * np.pi) - np.pi)
    assert difference.max() < (np.pi / 8 + 1e-6 if output == "one_hot" else 1e-6)
    assert len(np.unique(expected)) == 12
    assert np.hypot(*np.concatenate(vectors).T) == pytest.approx(np.full(12, 4.0))


@pytest.mark.parametrize(("controller", "noises"), [("trained", set()), ("random", {"decision_noise"})])
def test_no_evaluation_has_exploration_noise(tiny_run, controller, noises):
    with recording() as record:
        evaluate(tiny_run, episodes=1, num_workers=1, controller=controller)
    assert record.noises == noises


def test_the_command_shows_the_controller(tiny_run, capsys):
    assert evaluate(tiny_run, episodes=2).controller == "trained"
    assert main(["evaluate", str(tiny_run), "--episodes", "2", "--controller", "constant", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["controller"].removeprefix("constant: ") in NAMES
