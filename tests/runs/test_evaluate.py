"""Evaluation: fresh episodes of the mean policies, with the trained controller or one that has learned nothing."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.agents.goal_agent import GoalAgent
from shes.backends.backend import SerialBackend
from shes.cli import main
from shes.envs.bodies.point import Point
from shes.envs.named_environments import ENVIRONMENTS, Environment
from shes.envs.tasks.target_task import Maze
from shes.evolution.strategies import EvolutionAlgorithm
from shes.runs.evaluate import Evaluation, evaluate
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.runs.recorder import recording

ARRAYS = ("scores", "returns", "primitive_returns", "goals_reached", "successes", "steps", "diverged")


def same(one, other):
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


def test_neither_workers_nor_a_cluster_change_a_number(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "gone:6379")  # the cluster that trained the run need not be there
    # With three episodes per policy, the last block of seven episodes is not full.
    run = runs.train_tiny(tmp_path / "run", episodes_per_policy=3, generations=1)
    one = evaluate(run, episodes=7, controller="random")  # in this process
    config = run / "config.json"
    config.write_text(config.read_text().replace('"backend": "serial"', '"backend": "ray"'))
    two = evaluate(run, episodes=7, num_workers=2, controller="random")
    assert same(one, two)
    assert one.controller == two.controller == "random"
    assert one.scores.shape == (7,)


def test_fewer_episodes_are_the_first_and_a_seed_chooses_others(tiny_run):
    def found(episodes, seed=None, checkpoint="best"):
        with recording() as record:
            result = evaluate(tiny_run, episodes=episodes, num_workers=1, seed=seed, checkpoint=checkpoint)
        return result, record.seeds("evaluation")

    before = {path: path.read_bytes() for path in tiny_run.rglob("*") if path.is_file()}
    (few, of_few), (many, of_many), (one, of_one), (again, of_again) = found(3), found(5), found(5, 1), found(5, 1, "0")
    assert all(np.array_equal(getattr(few, name), getattr(many, name)[:3]) for name in ARRAYS)
    assert of_few == of_many[:3]
    assert of_again == of_one != of_many  # the same episodes for every checkpoint
    assert same(one, found(5, 1)[0])
    assert same(found(5, 1, "4")[0], found(5, 1, "last")[0])
    assert not same(one, again)
    assert not same(one, many)
    assert {path: path.read_bytes() for path in tiny_run.rglob("*") if path.is_file()} == before


def test_the_targets_of_training_come_without_its_falls(tmp_path, monkeypatch):
    # Evaluation's target is far: nobody comes nearer than 200 m to it, or further than 50 m from training's.
    monkeypatch.setattr(Maze, "own_target", (0.0, 300.0))
    run = runs.train_tiny(tmp_path / "run", "ant-maze", max_tilt=0.5, generations=1)
    assert np.mean(read_csv(run / "progress.csv")["terminated_rate"]) > 0.5
    one, other = (evaluate(run, episodes=3, targets=targets) for targets in ("evaluation", "training"))
    assert set(one.steps) == set(other.steps) == {20}
    assert one.returns.max() < 20 * -200
    assert other.returns.min() > 20 * -50


def test_a_summary_holds_means_and_deviations():
    values = ([0, 4], [-1, 3], [5, 6], [2, 1], [0, 1], [10, 20], [1, 0])
    found = Evaluation(**{name: np.array(each, float) for name, each in zip(ARRAYS, values, strict=True)})
    means = {"score_mean": 2.0, "score_std": 2.0, "return_mean": 1.0, "return_std": 2.0, "primitive_return_mean": 5.5}
    means |= {"goals_reached_mean": 1.5, "success_rate": 0.5, "episode_steps_mean": 15.0}
    assert found.summary() == {"episodes": 2, **means, "diverged_episodes": 1}


@pytest.mark.parametrize(
    ("env", "settings", "level"),
    [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {"controller_interval": 7}, "primitive")],
)
def test_a_run_of_one_level_is_evaluated_by_what_it_has(tmp_path, env, settings, level):
    path = runs.train_tiny(tmp_path / "run", env, generations=1, evaluation_horizon=30, **settings)
    found = evaluate(path, episodes=3)
    assert ({"primitive_return_mean", "goals_reached_mean"} <= found.summary().keys()) == (level == "primitive")
    if level == "primitive":  # the task pays by the same formula, in code of its own
        np.testing.assert_allclose(found.primitive_returns, found.returns, rtol=1e-9)
    table = read_csv(path / "evaluation.csv")
    assert set(found.summary()) == set(table) - {"generation", "env_steps", "wall_time_s", "process_time_s"}
    assert table["episode_steps_mean"].tolist() == [30]
    assert read_csv(path / "progress.csv")["episode_steps_mean"].tolist() == [20]
    assert found.controller is None
    assert "controller" not in found.listing().facts


def test_what_the_workers_tell_is_a_warning(tiny_run, monkeypatch, caplog):
    def tell(backend, tasks):
        backend.on_event("worker 7 is silent")
        return run(backend, tasks)

    run = SerialBackend.map
    monkeypatch.setattr(SerialBackend, "map", tell)
    evaluate(tiny_run, episodes=2)
    assert [(each.levelname, each.message) for each in caplog.records] == [("WARNING", "worker 7 is silent")]


NAMES = ["weights at zero", *(f"{degrees} degrees" for degrees in (0, 45, 90, 135, 180, -135, -90, -45))]
MAZE = {
    "target": (0.0, 3.0),
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
        weights = np.zeros((learner.design.networks["primitive"].sizes[0] + 1, 2), np.float32)
        weights[0, 0] = weights[1, 1] = 0.5
        identity = {"mean": np.zeros_like(primitive.mean), "inverse_std": np.ones_like(primitive.inverse_std)}
        return controller, replace(primitive, theta=weights.ravel(), **identity)

    original = EvolutionAlgorithm.parameters
    monkeypatch.setattr(EvolutionAlgorithm, "parameters", parameters)


@pytest.mark.parametrize("output", ["vector", "heading_direction", "one_hot"])
def test_the_best_of_nine_constant_controllers_counts(tmp_path, walking, monkeypatch, output, capsys):
    def act(agent, inputs):
        is_due = np.repeat(agent.clock % agent.design.controller_interval == 0, agent.rows_per_lane)
        controls = original(agent, inputs)
        if is_due.any():
            vectors.append((agent.goal - inputs.position)[is_due])
        return controls

    run = runs.train_tiny(tmp_path / "run", "point-maze", **MAZE, controller_output=output)
    original, vectors = GoalAgent.act, []  # to the goals [K, 2] of all decisions
    monkeypatch.setattr(GoalAgent, "act", act)
    assert main(["evaluate", str(run), "--episodes", "2", "--controller", "constant", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["controller"] == "constant: 90 degrees"
    ways = np.reshape(vectors, (9, 4, 2, 2))  # [controller, decision, episode, axis]
    if output.startswith("heading"):  # the point turns
        ways = ways[:, :1]
    angles = np.arctan2(ways[..., 1], ways[..., 0])
    for own, name in zip(angles[1:], NAMES[1:], strict=True):
        difference = own - math.radians(int(name.split()[0]))
        assert np.abs((difference + np.pi) % (2 * np.pi) - np.pi).max() < 0.2  # the heading is up to 0.1 rad off
    vectors.clear()
    assert evaluate(run, episodes=3, controller="random").controller == "random"
    assert np.hypot(*np.concatenate(vectors).T) == pytest.approx(np.full(12, 4.0))  # of 4 decisions in 3 episodes
    if output == "one_hot":  # the first of its eight directions
        assert (ways[0] < 0).all()
    else:
        assert np.abs(ways[0]).max() < 1e-6


class Contrary(Maze):
    """A maze that scores by the way to the right and pays for the way to the left, each if at all."""

    scores = pays = 1.0

    @property
    def score(self):
        return -self.scores * self.position[:, 1]

    def update_features(self):
        return self.pays * super().update_features()


@pytest.mark.parametrize(("scores", "pays", "best"), [(1, 1, "-"), (0, 1, "90 degrees"), (0, 0, NAMES[0])])
def test_the_highest_score_counts_then_the_return_then_the_first(tmp_path, walking, monkeypatch, scores, pays, best):
    monkeypatch.setitem(ENVIRONMENTS, "point-contrary", Environment(Point, Contrary))
    monkeypatch.setattr(Contrary, "scores", scores)
    monkeypatch.setattr(Contrary, "pays", pays)
    run = runs.train_tiny(tmp_path / "run", "point-contrary", **{**MAZE, "target": (0.0, 300.0)})
    assert evaluate(run, episodes=2, controller="constant").controller.startswith(f"constant: {best}")
