"""The search for a way beside evolution: when it goes on, what it costs, and whom its way guides."""

import itertools

import numpy as np
import pytest

import shes
from shes.algorithms.evolution import way_search
from shes.algorithms.evolution.populations import generation_work
from shes.backends.backend import Backend
from shes.errors import CheckpointError, ConfigError, UnknownNameError
from shes.es.archive import PATIENCE, wander
from shes.hierarchy.episodes import EpisodeResults, Snapshot
from shes.hierarchy.exploration import Exploration
from shes.runs.build import build_algorithm
from shes.runs.tables import read_csv
from shes.training.make_config import make_config
from tests.e2e import runs
from tests.hierarchy.made_up import outcomes
from tests.runs.recorder import recording

SEARCH = {
    "explore": "archive", "primitive_view": "egocentric", "controller_interval": 4, "evaluation_target": (5.5, 0.0),
    "target": (5.5, 0.0), "explore_horizon": 60,
}  # fmt: skip


@pytest.fixture
def quick(monkeypatch):
    """Searches begin at once, with short slices."""
    monkeypatch.setattr(way_search, "MIN_SPEED_M_S", -1e9)
    monkeypatch.setattr(way_search, "SLICE_STEPS", 2000)


class Steering(Backend):
    """Moves walkers from their places to their goals, at a `speed`, without physics; calls a place near (7, 0) solved.

    States are x, y and 0. Walkers fall where x is below -3, and lie where y is above 3.
    """

    def __init__(self, speed):
        self.speed, self.generations, self.starts = speed, [], []

    def broadcast(self, state):
        self.generations.append(state)

    def map(self, tasks):
        for task in tasks:
            self.starts.append(task.start)
            place = np.zeros(3) if task.start.state is None else task.start.state
            state = place + self.speed * np.append(task.start.goals[0] / 4, 0)
            end = Snapshot(state=state, steps=task.start.steps + 10) if state[0] > -3 else None
            yield EpisodeResults(outcomes=outcomes(returns=np.zeros((1, 1)), steps=[10]), moments=None, snapshots=[end])

    def close(self):
        """Do nothing."""


def decode(states):
    return (
        np.round(states[:, :2]).astype(np.int64), states[:, :2].copy(), states[:, 1] <= 3,
        np.hypot(states[:, 0] - 7, states[:, 1]) < 2,
    )  # fmt: skip


def searched(speed, generations, horizon=200, **settings):
    """Return the states of a search without physics after each generation, and its backend."""
    state = build_algorithm(make_config("point-maze", "smoke", {**SEARCH, "hidden": (4,)})).start(3)
    start = way_search.Archive.start(np.zeros((1, 2), np.int64), np.zeros((1, 2)), 3)
    search = way_search.WaySearch(
        decode=decode, start=start, interval=10, interval_s=1.0, horizon=horizon, goal_distance=4.0, **settings
    )
    state = way_search.replace(state, archive=start)
    backend, found = Steering(speed), []
    for generation in range(generations):
        state = way_search.explore(way_search.replace(state, generation=generation), search, backend)
        found.append(state)
    return found, backend


def test_a_search_finds_a_way_that_was_walked_shortens_it_and_ends():
    found, backend = searched(1.0, 40)
    archive = found[-1].archive
    assert (archive.is_over, archive.stalled) == (True, PATIENCE)
    assert archive.way_steps == 10 * (len(archive.way) - 1)
    assert archive.way[0].tolist() == [0, 0]
    assert np.hypot(*(archive.way[-1] - (7, 0))) < 2
    assert np.linalg.norm(np.diff(archive.way, axis=0), axis=1) == pytest.approx(1)  # a step of a walker each
    known = [state.archive.way_steps for state in found if state.archive.way_steps]
    assert known == sorted(known, reverse=True)
    assert 60 <= known[-1] <= 90  # the shortest has six decisions
    assert (archive.positions[archive.nodes, 1] <= 3).all()  # where walkers lie no cell is entered
    assert (archive.positions[:, 0] > -3).all()
    assert found[-1].env_steps == archive.env_steps == 10 * len(backend.starts)
    is_over = [state.archive.is_over for state in found]
    assert found[-1].env_steps == found[is_over.index(True)].env_steps  # from then on nothing is paid
    assert max(start.steps for start in backend.starts) < 200  # five decisions before the horizon at the latest
    assert {(each.kind, each.sigma, each.is_evaluation) for each in backend.generations} == {("exploration", 0, False)}


def test_every_decision_asks_for_a_goal_at_the_goal_distance_and_directions_turn():
    _, backend = searched(1.0, 1)
    goals = np.array([start.goals for start in backend.starts[: 5 * 64]]).reshape(-1, 64, 2)
    assert np.linalg.norm(goals, axis=2) == pytest.approx(4)
    turned = np.diff(np.arctan2(goals[..., 1], goals[..., 0]), axis=0)
    turned = np.abs((turned + np.pi) % (2 * np.pi) - np.pi)
    assert 0.6 < (turned < 0.9).mean() < 0.95  # the others are new directions
    assert len(np.unique(goals[0].round(6), axis=0)) == 64


def test_every_slice_takes_its_steps_and_walks_in_directions_of_its_own():
    found, backend = searched(1.0, 2)
    first, both = (state.env_steps for state in found)
    assert min(first, both - first) >= way_search.SLICE_STEPS
    starts = backend.starts[:64], backend.starts[first // 10 :][:64]
    goals = [np.array([start.goals[0] for start in each]) for each in starts]
    assert not np.isclose(*goals).any()


def test_walkers_are_counted_in_the_cells_where_they_begin():
    found, backend = searched(1.0, 2)
    archive = found[-1].archive
    begun = len([start for start in backend.starts if start.steps == 0])
    assert archive.chosen[archive.steps == 0].tolist() == [begun]
    assert archive.chosen.sum() % way_search.WALKERS == 0
    assert archive.chosen.sum() > begun >= way_search.WALKERS


def test_a_frozen_primitive_searches_in_one_generation_until_a_way_is_known(quick, monkeypatch):
    monkeypatch.setattr(way_search, "SLICE_STEPS", 1)  # a slice is one walk
    slice_by_slice, _ = searched(0.4, 12, 400)
    found, _ = searched(0.4, 2, 400, slices=10)
    at_once = [bool(state.archive.way_steps) for state in found]
    number = [bool(state.archive.way_steps) for state in slice_by_slice].index(True) + 1
    assert 2 < number <= 10
    assert at_once == [True, True]
    assert found[0].env_steps > 2 * (found[1].env_steps - found[0].env_steps) > 0  # afterwards it is one slice
    limited, _ = searched(0.4, 1, 400, slices=2)
    assert found[0].env_steps > limited[0].env_steps > found[1].env_steps - found[0].env_steps
    assert limited[0].archive.way_steps == 0
    frozen = {"primitive": "ant-walker", "explore": "archive", "target": (0.0, 16.0)}
    for settings, slices in ((frozen, way_search.SLICES), ({}, 1)):
        assert build_algorithm(make_config("ant-maze", "laptop", settings)).hyperparameters.search.slices == slices


@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_a_primitive_that_does_not_walk_is_asked_again_in_every_generation(speed):
    found, _ = searched(speed, 3)
    walk = 64 * 5 * 10
    assert [state.env_steps for state in found] == [walk, 2 * walk, 3 * walk]
    assert [len(state.archive.cells) for state in found] == [1, 1, 1]


def test_no_walker_leaves_later_than_the_horizon_allows():
    found, backend = searched(1.0, 3, horizon=30)
    assert max(start.steps for start in backend.starts) == 20
    assert found[-1].archive.way_steps == 0  # three decisions do not suffice
    assert {start.state is None for start in backend.starts if start.steps == 0} == {True}


def test_the_steps_of_the_search_are_steps_of_the_run(quick, tmp_path):
    path = runs.train_tiny(tmp_path / "run", "point-maze", **SEARCH, generations=3)
    rows = read_csv(path / "progress.csv")
    steps = list(map(int, rows["exploration_steps"]))
    assert steps[0] >= 2000
    assert [int(total) - searching for total, searching in zip(rows["env_steps"], steps, strict=True)] == [
        160, 320, 480,
    ]  # fmt: skip
    assert rows["cells"] == sorted(rows["cells"])
    assert rows["cells"][0] > 1


def test_a_way_guides_training_alone(quick):
    algorithm = build_algorithm(make_config("point-maze", "smoke", {**SEARCH, "hidden": (4,), "horizon": 20}))
    state = algorithm.start(3)
    rules, table = algorithm.hyperparameters, algorithm.table
    assert generation_work(state, rules, table.size).generation.way is None
    way = np.array([[0.0, 0], [3, 0.1], [6, 0], [6, 4]])
    state = way_search.replace(state, archive=way_search.replace(state.archive, way=way, way_steps=12))
    assert generation_work(state, rules, table.size).generation.way.tolist() == way[1:].tolist()
    found = algorithm.explored(state)
    assert found.way.tolist() == way.tolist()


@pytest.mark.parametrize("estimate", ["episode", "interval"])
def test_goals_wander_and_the_controller_waits_until_a_way_is_known(estimate):
    settings = {**SEARCH, "hidden": (4,), "horizon": 20, "primitive_estimate": estimate}
    algorithm = build_algorithm(make_config("point-maze", "smoke", settings))
    state, rules = algorithm.start(3), algorithm.hyperparameters
    before = generation_work(state, rules, algorithm.table.size)
    known = way_search.replace(state, archive=way_search.replace(state.archive, way=np.ones((2, 2)), way_steps=9))
    after = generation_work(known, rules, algorithm.table.size)
    assert (before.generation.decisions, after.generation.decisions) == ("wander", None)
    assert not before.generation.levels[0].theta.any()
    assert after.generation.levels[0].theta.tolist() == state.levels[0].theta.tolist()
    assert not before.signs[..., 0].any()
    assert (after.signs[..., 0] != 0).all()
    assert before.signs[..., 1].tolist() == after.signs[..., 1].tolist()
    assert {tuple(signs[0] for signs in task.signs) for task in before.tasks} <= {(0, 0), (0, 0, 0, 0)}
    seeds = [[seed for task in work.tasks for seed in task.seeds] for work in (before, after)]
    group = after.signs.shape[1]  # it shares its seeds, but not if all its members are the same
    assert [len(set(each)) for each in seeds] == [16 if estimate == "interval" else 16 // group, 16 // group]


def test_robots_that_wander_do_so_by_the_seed_and_have_the_control_noise_of_training():
    algorithm = build_algorithm(make_config("point-maze", "smoke", {**SEARCH, "hidden": (4,), "horizon": 20}))
    work = generation_work(algorithm.start(3), algorithm.hyperparameters, algorithm.table.size)
    found = []
    for generation in (work.generation, way_search.replace(work.generation, decisions=None)):
        exploration = Exploration(algorithm.design.make(1, generation.rows_per_lane), 20, 2)
        exploration.begin(generation)
        exploration.draw(0, work.tasks[0])
        exploration.upload()
        found.append(exploration.of_step())
        if generation.decisions == "wander":
            decided = exploration._drawn[0][:, 0, 0]
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(work.tasks[0].seeds[0], spawn_key=(3,))))
    angles = wander(rng, 5, 1)[:, 0]  # a decision in every 4 of 20 steps
    assert decided == pytest.approx(np.stack([np.cos(angles), np.sin(angles)], axis=1), abs=1e-6)
    wandering, learned = found
    assert wandering["control_noise"].any()
    assert wandering["control_noise"].tolist() == learned["control_noise"].tolist()
    assert wandering["decision_noise"].tolist() != learned["decision_noise"].tolist()


def trained(path, generations=3, **settings):
    return runs.train_tiny(path, "point-push", **{**SEARCH, "generations": generations, **settings})


def test_the_reward_of_training_leads_through_the_way_and_that_of_evaluation_does_not(quick, tmp_path):
    with recording() as record:
        trained(tmp_path / "run")
    ways = [each.generation.way for each in record.of("training")]
    last = record.of("training")[-1].rollout.batch
    assert last._way[:-1].tolist() == ways[-1].tolist() != []
    assert {each.generation.way is None for each in record.of("evaluation")} == {True}
    assert record.of("evaluation")[-1].rollout.batch._num_waypoints == 0


@pytest.mark.parametrize("primitive", ["interval", "episode"])
def test_workers_and_a_resume_in_the_middle_of_a_search_change_no_number(quick, tmp_path, primitive):
    """A way is known after some slices, so that all kinds of states are compared."""
    one = trained(tmp_path / "one", primitive_estimate=primitive)
    two = trained(tmp_path / "two", 1, primitive_estimate=primitive, num_workers=3, backend="processes")
    shes.resume(two, generations=3, num_workers=2)
    assert runs.differences(one, two) == []
    numbers = runs.numbers(one)
    cells = [len(numbers[f"{name}.npz/archive/cells"]) for name in ("generation_000000", "last")]
    assert 1 == cells[0] < cells[1]
    assert numbers["last.npz/archive/way_steps"] > 0


def test_a_shipped_agent_has_the_map_and_no_states(quick, tmp_path):
    algorithm = build_algorithm(make_config("point-push", "smoke", {**SEARCH, "hidden": (4,), "horizon": 20}))
    state = runs.state(trained(tmp_path / "run", 1))
    shipped = algorithm.without_training(state)
    assert (len(shipped.archive.states), len(state.archive.states)) == (0, len(state.archive.cells))
    assert len(algorithm.explored(shipped).places) > 1
    assert algorithm.from_arrays(algorithm.to_arrays(shipped)).archive.is_over


@pytest.mark.parametrize(
    ("env", "settings", "message"),
    [
        ("point-gather", {}, r"point-gather has no target with a way.*only Maze, Push and Fall.* Set --explore none"),
        ("gymnasium:Pendulum-v1", {}, r"Pendulum-v1 has no target with a way.* Set --explore none"),
        ("point-flagrun", {}, r"explore is not a setting of a run of point-flagrun.* Omit --explore"),
        ("point-maze", {"algorithm": "es"}, r"explore is not a setting of a run of point-maze with algorithm 'es'"),
        ("point-maze", {}, r"the training target is random\. Set --target, e\.g\. --target 0 16, or --explore none"),
        (
            "point-maze",
            {"target": (8.0, 0.0)},
            r"evaluation's target \(0\.0, 16\.0\), but the training target is \(8\.0, 0\.0\)\. Set --target 0 16",
        ),
        (
            "point-push",
            {"evaluation_target": (1.0, 2.5)},
            r"the training target is \(0\.0, 19\.0\)\. Set --target 1 2\.5, or --explore none",
        ),
        (
            "point-push",
            {"explore_horizon": 9},
            r"explore_horizon must be at least controller_interval, 25.*, got 9\. Set",
        ),
        ("point-push", {"waypoints": (1.0, 2.0)}, r"waypoints \(1\.0, 2\.0\) are a way already\. Set --waypoints none"),
        (
            "point-push",
            {"primitive_view": "observation"},
            r"the primitive sees the task's observation.* Set --primitive-view egocentric or proprioception",
        ),
        ("point-push", {"explore": "none", "explore_horizon": 9}, r"explore_horizon has no effect with explore 'none'"),
        ("point-push", {"explore": "novelty"}, r"unknown explore 'novelty'\. Known: archive, none.*Set --explore"),
    ],
)
def test_where_no_way_can_be_searched_for_the_fix_is_named(env, settings, message):
    settings = {"explore": "archive", "primitive_view": "egocentric", **settings}
    if settings.get("algorithm") == "es" or env == "point-flagrun":
        settings = {name: value for name, value in settings.items() if name in ("explore", "algorithm")}
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        make_config(env, "smoke", settings)


def test_the_shapes_of_an_archive_are_checked(quick):
    algorithm = build_algorithm(make_config("point-push", "smoke", {**SEARCH, "hidden": (4,), "horizon": 20}))
    arrays = algorithm.to_arrays(algorithm.start(1))
    assert {name for name in arrays if name.startswith("archive/")} == {
        f"archive/{name}" for name in ("cells", "states", "steps", "chosen", "nodes", "parents", "positions", "way",
                                       "way_steps", "stalled", "env_steps")
    }  # fmt: skip
    for name, change in itertools.product(("archive/cells", "archive/states"), (lambda a: a[:, :1], lambda a: a[0])):
        with pytest.raises(CheckpointError, match=rf"holds {name} as .* of shape .*, where this run has"):
            algorithm.from_arrays({**arrays, name: change(arrays[name])})
    for name in ("steps", "chosen", "nodes", "states", "positions"):
        twice = np.concatenate([arrays[f"archive/{name}"]] * 2)
        with pytest.raises(CheckpointError, match=rf"holds archive/{name} of length 2, where archive/\w+ has 1\. Put"):
            algorithm.from_arrays({**arrays, f"archive/{name}": twice})
