"""The search for a way during evolution: when it goes on, what it costs, and whom its way guides."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import shes
from shes.backends.backend import Backend
from shes.evolution import way_search
from shes.evolution.estimates import draw_episodes
from shes.evolution.state import PATIENCE, Archive
from shes.rollout.episodes import EpisodeResults, Snapshot
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.rollout.made_up import outcomes

SEARCH = {"explore": "archive", "primitive_view": "egocentric", "controller_interval": 4, "explore_horizon": 60}
SEARCH["target"] = (5.5, 0.0)
WALKERS = way_search.WALKERS


def built(env="point-maze", **settings):
    return build_algorithm(make_config(env, "smoke", {**SEARCH, "hidden": (4,), "horizon": 20, **settings}))


@pytest.fixture(autouse=True)
def short_slices(monkeypatch):
    """Slices are short."""
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
            end = (Snapshot(state=state, steps=task.start.steps + 10),) if state[0] > -3 else ()
            yield EpisodeResults(outcomes=outcomes(returns=np.zeros((1, 1)), steps=[10]), moments=None, snapshots=[end])

    def close(self):
        """Do nothing."""


def decode(states):
    places = states[:, :2]
    return np.round(places).astype(int), places.copy(), places[:, 1] <= 3, np.hypot(*(places - (7, 0)).T) < 2


def searched(speed, generations, horizon=200, *, primitive_learns=False):
    """Return the states of a search without physics after each generation, and its backend."""
    start = Archive.start(np.zeros((1, 2), np.int64), np.zeros((1, 2)), 3)
    search = way_search.WaySearch(decode=decode, start=start, interval=10, horizon=horizon,
                                  goal_distance=4.0, primitive_learns=primitive_learns)  # fmt: skip
    state, backend, found = replace(built().start(3), archive=start), Steering(speed), []
    for generation in range(generations):
        state = way_search.explore(replace(state, generation=generation), search, backend)
        found.append(state)
    return found, backend


def test_a_search_finds_a_way_shortens_it_and_ends():
    found, backend = searched(1.0, 40)
    archive = found[-1].archive
    assert (archive.is_over, archive.stalled, archive.way_steps) == (True, PATIENCE, 10 * (len(archive.way) - 1))
    assert np.hypot(*(archive.way[[0, -1]] - [(0, 0), (7, 0)]).T).tolist() == [0, pytest.approx(0, abs=2)]
    assert np.linalg.norm(np.diff(archive.way, axis=0), axis=1) == pytest.approx(1)  # a step of a walker each
    places, inner = (set(map(tuple, each[:, :2].round().tolist())) for each in (archive.starts, archive.way[1:-1]))
    assert 1 < len(places) == len(places & inner)
    known = [state.archive.way_steps for state in found if state.archive.way_steps]
    assert known == sorted(known, reverse=True)
    assert 60 <= known[-1] <= 90  # the shortest has six decisions
    assert (archive.positions[archive.nodes, 1] <= 3).all()  # where walkers lie no cell is entered
    assert (archive.positions[:, 0] > -3).all()
    assert found[-1].env_steps == archive.env_steps == 10 * len(backend.starts)
    is_over = [state.archive.is_over for state in found]
    assert found[-1].env_steps == found[is_over.index(True)].env_steps  # from then on nothing is paid
    assert max(start.steps for start in backend.starts) < 200  # five decisions before the horizon at the latest
    assert {(each.kind, each.sigma) for each in backend.generations} == {("exploration", 0)}


def test_walkers_turn_at_times_each_in_directions_of_its_own():
    """Every decision is a goal at the goal distance; a slice takes its steps, and counts where its walkers begin."""
    found, backend = searched(1.0, 2)
    goals = np.array([start.goals for start in backend.starts[: 5 * WALKERS]]).reshape(-1, WALKERS, 2)
    assert np.linalg.norm(goals, axis=2) == pytest.approx(4)
    turned = np.diff(np.arctan2(goals[..., 1], goals[..., 0]), axis=0)
    turned = np.abs((turned + np.pi) % (2 * np.pi) - np.pi)
    assert 0.6 < (turned < 0.9).mean() < 0.95  # the others are new directions
    assert len(np.unique(goals[0].round(6), axis=0)) == WALKERS
    first, both = (state.env_steps for state in found)
    assert min(first, both - first) >= way_search.SLICE_STEPS
    later = [start.goals[0] for start in backend.starts[first // 10 :][:WALKERS]]
    assert not np.isclose(goals[0], later).any()
    archive, begun = found[-1].archive, sum(start.steps == 0 for start in backend.starts)
    assert archive.chosen[archive.steps == 0].tolist() == [begun]
    assert archive.chosen.sum() % WALKERS == 0
    assert archive.chosen.sum() > begun >= WALKERS


def test_a_frozen_primitive_searches_until_a_way_is_known(monkeypatch):
    """Many slices in one generation, as long as nothing else can be learned; a slice is one walk here."""
    slowly, found = (searched(0.4, most, 400, primitive_learns=learns)[0] for most, learns in ((12, True), (2, False)))
    monkeypatch.setattr(way_search, "SLICES", 2)
    limited = searched(0.4, 1, 400)[0]
    assert 2 < [bool(state.archive.way_steps) for state in slowly].index(True) + 1 <= 10
    assert [bool(state.archive.way_steps) for state in (*found, *limited)] == [True, True, False]
    later = found[1].env_steps - found[0].env_steps
    assert found[0].env_steps > limited[0].env_steps > later > 0  # afterwards it is one slice
    cases = {}, {"primitive_estimate": "episode", "fitness_shaping": "centred_rank"}, {"primitive": "ant-walker"}
    *others, frozen = (build_algorithm(make_config("ant-maze", "laptop", each)) for each in cases)
    assert [each.hyperparameters.practice for each in (*others, frozen)] == [60, 0, 0]
    assert [each.hyperparameters.search.primitive_learns for each in (frozen, built())] == [False, True]


def test_with_a_primitive_that_learns_a_stalled_search_goes_on_at_times():
    archives = [state.archive for state in searched(1.0, 40, primitive_learns=True)[0]]
    assert not archives[-1].is_over
    pairs = [*enumerate(pairwise(archives), 1)]
    rested = {number for number, (before, after) in pairs if before.env_steps == after.env_steps}
    stalled = {number for number, (before, _) in pairs if before.stalled >= PATIENCE}
    assert rested == {number for number in stalled if number % way_search.REST} != set()
    assert stalled - rested != set()


def test_followers_head_for_points_ahead_on_the_way():
    """Their first goal is two or three points ahead, their second three to six, as far as the way goes."""
    found, backend = searched(1.0, 12)
    number = next(i for i, state in enumerate(found) if state.archive.way_steps)
    way, begun = found[number].archive.way, found[number].env_steps // 10
    first, second = (backend.starts[begun + i * WALKERS :][: way_search.FOLLOWERS] for i in (0, 1))
    passed = [each.steps // 10 for each in first]
    assert len(set(passed)) > 2
    for starts, least, most in ((first, 2, 3), (second, 3, 6)):
        aheads = set()
        for i, start in zip(passed, starts, strict=True):
            aims = way[[min(i + ahead, len(way) - 1) for ahead in range(least, most + 1)]]
            x, y = (aims - (np.zeros(2) if start.state is None else start.state[:2])).T
            goals = 4 * np.stack([np.cos(np.arctan2(y, x)), np.sin(np.arctan2(y, x))], axis=1)
            off = np.abs(goals - start.goals[0]).sum(axis=1)
            assert off.min() < 1e-9
            aheads.add(int(off.argmin()))
        assert len(aheads) > 1  # each at its own pace
    at_reset = sum(start.steps == 0 for start in backend.starts)
    archive = found[-1].archive
    assert archive.chosen[archive.steps == 0].tolist() == [at_reset]
    assert len({start.goals.tobytes() for start in backend.starts[begun:][:WALKERS]}) > WALKERS // 2  # others wander


def test_no_walker_leaves_later_than_the_horizon_allows():
    found, backend = searched(1.0, 3, horizon=30)
    assert max(start.steps for start in backend.starts) == 20
    assert found[-1].archive.way_steps == 0  # three decisions do not suffice
    assert {start.state is None for start in backend.starts if start.steps == 0} == {True}


@pytest.mark.parametrize(("estimate", "practice"), [("episode", 0), ("interval", 0), ("interval", 3)])
def test_goals_wander_in_practice_and_until_a_way_is_known(estimate, practice):
    schedules = {"practice": practice, "sigma_end": 0.01, "learning_rate_end": 1e-4, "schedule_generations": 1}
    algorithm = built(primitive_estimate=estimate, **(schedules if practice else {}))
    state = replace(algorithm.start(3), generation=2)
    way = np.array([[0.0, 0], [3, 0.1], [6, 0], [6, 4]])
    known = replace(
        state,
        archive=replace(state.archive, positions=way, way_nodes=np.arange(4), way_steps=12),
        generation=max(2, practice),
    )
    early = replace(known, generation=2) if practice else state
    before, after = (draw_episodes(each, algorithm.hyperparameters, algorithm.table.size) for each in (early, known))
    assert (before.generation.decisions, after.generation.decisions) == ("wander", None)
    assert (after.generation.sigma, after.learning_rate) == (0.07, 0.01)  # the schedules begin after the practice
    assert after.generation.way.tolist() == way[1:].tolist()
    assert not before.generation.levels[0].theta.any()
    assert after.generation.levels[0].theta.tolist() == state.levels[0].theta.tolist()
    assert before.generation.levels[1].theta.tolist() == state.levels[1].theta.tolist()
    assert after.signs[..., 0].all()
    groups = 1 if estimate == "interval" else len(after.signs)  # where no level learns, one shows how they do
    assert before.signs.tolist() == (after.signs[:groups] * np.array([0, 1])).tolist()
    assert {signs[0] for task in before.tasks for signs in task.signs} == {0}
    seeds = [len({seed for task in draws.tasks for seed in task.seeds}) for draws in (before, after)]
    group = after.signs.shape[1]  # it shares its seeds, but not if all its members are the same
    assert seeds == [group if estimate == "interval" else 16 // group, 16 // group]


def test_half_of_the_groups_begin_on_the_way():
    state = built().start(3)
    known = replace(state.archive, way_nodes=np.zeros(5, np.int64), way_steps=40, starts=np.arange(12.0).reshape(3, 4))
    found, algorithm = [], built(population_size=160)
    for archive, generation in ((state.archive, 1), (known, 1), (known, 2)):
        now = replace(state, archive=archive, generation=generation)
        draws, groups = draw_episodes(now, algorithm.hyperparameters, algorithm.table.size), {}
        for task in draws.tasks:
            groups.setdefault(task.noise_index, []).append(task.start)
        assert all(start is starts[0] for starts in groups.values() for start in starts)
        found.append([None if starts[0] is None else starts[0].state.tolist() for starts in groups.values()])
        assert {task.start.steps for task in draws.tasks if task.start} <= {0}
    before, first, second = found
    assert {*before} == {None}
    assert 10 <= first.count(None) <= 30  # of 40
    assert [own for own in known.starts.tolist() if own not in first] == []
    assert first != second


def test_workers_and_a_resume_in_a_search_change_no_number(tmp_path):
    """The way leads the reward of training alone, and the steps of the search are steps of the run."""
    settings = {**SEARCH, "primitive_estimate": "interval", "practice": 1, "target": (5.6, 0.0)}
    one = runs.train_tiny(tmp_path / "one", "point-push", **settings, generations=3)
    two = runs.train_tiny(tmp_path / "two", "point-push", **settings, generations=1, num_workers=2, backend="processes")
    shes.resume(two, generations=3, backend="serial")
    assert runs.differences(one, two) == []
    rows, state = read_csv(one / "progress.csv"), runs.state(one)
    assert len(state.archive.cells) == rows["cells"][2] > rows["cells"][1] > rows["cells"][0] == 1
    assert (steps := rows["exploration_steps"])[0] == 0  # the search begins after the practice
    assert rows["env_steps"][2] - steps[2] <= 3 * (160 + 64) < 2000 < steps[1]
    assert state.archive.way_steps == rows["way_steps"][2] > 0
    returns = rows["controller_return_mean"]  # progress, at last, while the target is 5 m away for 20 steps
    assert returns[2] > -20 > returns[1]
    assert read_csv(one / "evaluation.csv")["return_mean"][0] < -80
    algorithm = built("point-push", primitive_estimate="interval")
    shipped = algorithm.without_training(state)  # it has the map alone
    assert (len(shipped.archive.states), len(state.archive.states)) == (0, rows["cells"][2])
    assert (len(shipped.archive.starts), len(state.archive.starts) > 0) == (0, True)
    assert len(algorithm.explored(shipped).places) > 1
    assert algorithm.explored(shipped).way.tolist() == state.archive.way[:, :2].tolist()
    assert algorithm.from_arrays(algorithm.to_arrays(shipped)).archive.is_over
