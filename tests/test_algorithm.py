"""`evolve`: the textbook's iterates, the same bits on any workers, and tasks that say what they should."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shes.algorithm import Settings, evolve
from shes.backends.backend import Backend
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.envs.registry import find_environment, make_task
from shes.envs.task import TaskOptions
from shes.errors import ConfigError
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.episodes import EpisodeResults, LevelMoments
from shes.hierarchy.goals import AngleEncoding
from shes.hierarchy.rewards import ProgressReward
from shes.policies.mlp import MLP
from shes.types import CONTROLLER, PRIMITIVE
from shes.worker import RolloutWorker, WorkerPlan
from tests.es.textbook import TextbookES

DIMS = (3, 5)
EPISODES = 3
SETTINGS = Settings(
    population_size=8,
    episodes_per_policy=EPISODES,
    sigma=0.1,
    update=UpdateRule(learning_rate=0.02, weight_decay=0.005),
)


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


def _start(thetas, sizes, seed=3):
    levels = tuple(
        LevelState(theta=theta, optimizer=Adam().start(len(theta)), statistics=ObservationStatistics.empty(size))
        for theta, size in zip(thetas, sizes, strict=True)
    )
    return TrainState(seed=seed, generation=0, env_steps=0, levels=levels)


# On made-up fitness: a backend that needs no physics ------------------------------------------------------------------


class FormulaBackend(Backend):
    """Pays each member by a formula of its parameters, and remembers what it was asked."""

    num_workers = 3

    def __init__(self, table):
        self.table = table
        self.generations = []
        self.tasks = []

    def broadcast(self, state):
        self.generations.append(state)
        self.tasks.append([])

    def map(self, tasks):
        for task in tasks:
            self.tasks[-1].append(task)
            generation = self.generations[-1]
            controller, primitive = (
                level.theta + sign * generation.sigma * self.table.slice(index, len(level.theta))
                for level, sign, index in zip(generation.levels, task.signs, task.noise_index, strict=True)
            )
            k = len(task.slots)
            moments = tuple(
                LevelMoments(
                    count=np.full(k, 7), total=np.full((k, size), 14.0), total_squares=np.full((k, size), 63.0)
                )
                for size in DIMS
            )
            # Each episode pays a little more or less, so that fitness is a mean over episodes.
            luck = np.array(task.slots) - (EPISODES - 1) / 2
            yield EpisodeResults(
                returns=np.array(formula(controller, primitive))[:, None] + luck,
                score=luck,
                success=luck > 0,
                steps=100 + np.array(task.slots),
                has_terminated=luck > 0,
                has_diverged=luck < 0,
                moments=moments if task.records_statistics else None,
            )

    def close(self):
        pass


def formula(controller, primitive):
    """Return the made-up fitness of a pair at both levels: they need each other, and are paid differently."""
    controller, primitive = np.asarray(controller, float), np.asarray(primitive, float)
    return -((controller - primitive[:3] - 1) ** 2).sum(), -((primitive - 2) ** 2).sum() + controller[0]


def _formula_run(table, generations, settings=SETTINGS, state=None, pool=None):
    backend = FormulaBackend(table)
    if state is None:
        rng = np.random.default_rng(0)
        state = _start([rng.normal(size=dim).astype(np.float32) for dim in DIMS], DIMS)
    return backend, list(itertools.islice(evolve(state, settings, table, backend, pool), generations))


@pytest.mark.parametrize("ties", ["average", "index"])
@pytest.mark.parametrize(("mirrored", "members"), [("quad", 4), ("pair", 2), ("none", 1)])
def test_generations_are_the_textbooks(table, mirrored, members, ties):
    update = replace(SETTINGS.update, rank_ties=ties)
    settings = replace(SETTINGS, population_size=12, mirrored=mirrored, update=update)
    backend, reports = _formula_run(table, 5, settings)
    book = TextbookES(
        [level.theta for level in backend.generations[0].levels],
        mirrored=mirrored, sigma=0.1, rate=0.02, weight_decay=0.005, ties=ties,
    )  # fmt: skip
    for report in reports:
        assert report.noise_index.shape == (2, 12 // members)
        noise = [[table.slice(i, dim) for i in row.tolist()] for row, dim in zip(report.noise_index, DIMS, strict=True)]
        expected = np.array([formula(*pair) for pair in book.candidates(noise)]).T
        assert report.results.fitness == pytest.approx(expected, rel=1e-4, abs=1e-4)
        book.update(report.results.fitness.tolist(), noise)
        for level, theta in zip(report.state.levels, book.thetas, strict=True):
            assert level.theta == pytest.approx(theta, abs=1e-5)


def test_both_levels_learn(table):
    settings = replace(SETTINGS, population_size=40, update=UpdateRule(learning_rate=0.05))
    _, reports = _formula_run(table, 150, settings)
    assert reports[-1].state.levels[PRIMITIVE].theta == pytest.approx(np.full(5, 2), abs=0.15)
    assert reports[-1].state.levels[CONTROLLER].theta == pytest.approx(np.full(3, 3), abs=0.2)


def test_a_run_that_stopped_goes_on_as_if_it_had_not(table):
    _, whole = _formula_run(table, 6)
    _, half = _formula_run(table, 2)
    _, rest = _formula_run(table, 4, state=half[-1].state)
    assert _state_bits(rest[-1].state) == _state_bits(whole[-1].state)
    assert rest[-1].state.generation == 6


def test_threads_for_the_gradient_change_no_bit(table):
    with ThreadPoolExecutor(3) as pool:
        _, threaded = _formula_run(table, 3, pool=pool)
    assert _state_bits(threaded[-1].state) == _state_bits(_formula_run(table, 3)[1][-1].state)


def test_the_state_before_stays_as_it_was(table):
    state = _start([np.ones(dim, np.float32) for dim in DIMS], DIMS)
    before = _state_bits(state)
    _formula_run(table, 2, state=state)
    assert _state_bits(state) == before


def test_workers_get_the_mean_policies_with_the_normalisation_of_the_generation(table):
    backend, reports = _formula_run(table, 2)
    first, second = backend.generations
    assert not first.is_evaluation
    assert first.sigma == 0.1
    for old, new, level, dim in zip(first.levels, second.levels, reports[0].state.levels, DIMS, strict=True):
        assert old.inverse_std.tolist() == [1] * dim  # nothing observed yet
        assert new.theta.tobytes() == level.theta.tobytes()
        assert new.mean == pytest.approx(np.full(dim, 2))  # 14 / 7
        assert 1 / new.inverse_std == pytest.approx(np.full(dim, 5**0.5))  # 63 / 7 - 4


def _whole_tasks(tasks):
    """Return seeds and flags by member, whether its episodes came together or alone."""
    seeds, records = {}, {}
    for task in tasks:
        seeds.setdefault(task.member, []).extend(task.seeds)
        records.setdefault(task.member, set()).add(task.records_statistics)
    assert all(len(found) == EPISODES for found in seeds.values())
    return [tuple(seeds[m]) for m in sorted(seeds)], [records[m].pop() for m in sorted(records)]


def test_with_common_random_numbers_the_members_of_a_group_share_their_seeds(table):
    backend, _ = _formula_run(table, 3, replace(SETTINGS, population_size=16))
    groups = []
    for tasks in backend.tasks:
        seeds, _ = _whole_tasks(tasks)
        assert len(seeds) == 16
        for start in range(0, 16, 4):
            assert len(set(seeds[start : start + 4])) == 1
            groups.append(seeds[start])
    distinct = {seed for group in groups for seed in group}
    assert len(distinct) == 3 * 4 * EPISODES  # other seeds in every group, episode and generation


def test_without_common_random_numbers_all_seeds_differ(table):
    settings = replace(SETTINGS, population_size=16, has_common_random_numbers=False)
    backend, _ = _formula_run(table, 3, settings)
    seeds = [seed for tasks in backend.tasks for member in _whole_tasks(tasks)[0] for seed in member]
    assert len(set(seeds)) == len(seeds) == 3 * 16 * EPISODES


def test_common_random_numbers_change_no_noise(table):
    _, on = _formula_run(table, 1)
    _, off = _formula_run(table, 1, replace(SETTINGS, has_common_random_numbers=False))
    assert np.array_equal(on[0].noise_index, off[0].noise_index)


def test_tasks_say_who_perturbs_how(table):
    backend, reports = _formula_run(table, 1)
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    members = {task.member: task for task in backend.tasks[0]}
    assert sorted(members) == list(range(8))
    for member, task in members.items():
        assert task.signs == signs[member % 4]
        assert task.noise_index == tuple(reports[0].noise_index[:, member // 4].tolist())


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_a_share_of_the_groups_enters_the_statistics(table, fraction):
    settings = replace(SETTINGS, population_size=80, statistics_fraction=fraction)
    backend, reports = _formula_run(table, 2, settings)
    recorded = 0
    for tasks in backend.tasks:
        _, flags = _whole_tasks(tasks)
        groups = [set(flags[start : start + 4]) for start in range(0, 80, 4)]
        assert all(len(group) == 1 for group in groups)
        recorded += sum(flags)
    assert fraction * 160 == pytest.approx(recorded, abs=48 if fraction == 0.5 else 0)
    for level in reports[-1].state.levels:
        assert level.statistics.count == recorded * EPISODES * 7


def test_environment_steps_add_up(table):
    _, reports = _formula_run(table, 3)
    assert [report.state.env_steps for report in reports] == [8 * (100 + 101 + 102) * k for k in (1, 2, 3)]
    assert [report.state.generation for report in reports] == [1, 2, 3]


def test_results_stand_by_member_and_episode(table):
    _, reports = _formula_run(table, 1)
    results = reports[0].results
    assert results.returns.shape == (2, 8, EPISODES)
    assert results.score.tolist() == [[-1, 0, 1]] * 8
    assert results.steps.tolist() == [[100, 101, 102]] * 8
    assert results.has_diverged.tolist() == [[True, False, False]] * 8


def test_a_population_that_groups_do_not_fill_is_refused(table):
    with pytest.raises(ConfigError, match=r"multiple of 4 .*got 10"):
        _formula_run(table, 1, replace(SETTINGS, population_size=10))


def _state_bits(state):
    arrays = [
        a
        for level in state.levels
        for a in (level.theta, level.optimizer.first, level.optimizer.second, level.statistics.total,
                  level.statistics.total_squares)
    ]  # fmt: skip
    counts = [(level.optimizer.steps, level.statistics.count) for level in state.levels]
    return [a.tobytes() for a in arrays], counts, state.generation, state.env_steps, state.seed


def test_another_seed_has_other_noise_and_other_episodes(table):
    state = _start([np.ones(dim, np.float32) for dim in DIMS], DIMS)
    (backend, reports), (other_backend, other) = (
        _formula_run(table, 1, state=replace(state, seed=seed)) for seed in (3, 4)
    )
    assert not set(reports[0].noise_index.ravel()) & set(other[0].noise_index.ravel())
    seeds, other_seeds = ({seed for task in b.tasks[0] for seed in task.seeds} for b in (backend, other_backend))
    assert not seeds & other_seeds


# On point-gather -----------------------------------------------------------------------------------------------------

HORIZON = 30


def _point_gather():
    """Return the design and the state before the first generation."""
    task = make_task("point-gather", 1)
    design = AgentDesign(
        controller=MLP(task.observation_size, (8,), 2),
        primitive=MLP(3 + task.observation_size, (8,), task.action_size),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        goal_distance=4.0,
        controller_interval=8,
        has_minimum_goal_distance=True,
        control_limit=task.control_limit,
    )
    rng = np.random.default_rng(0)
    return design, _start([mlp.initial(rng, "glorot_normal") for mlp in design.policies], design.observation_sizes)


def _point_gather_run(make_backend, table, *, chunk_size=0, settings=SETTINGS, generations=3):
    design, state = _point_gather()
    plan = WorkerPlan(
        env=find_environment("point-gather"),
        training=TaskOptions(),
        evaluation=TaskOptions(evaluation=True),
        design=design,
        noise_table=table.path,
        episodes_per_policy=settings.episodes_per_policy,
        horizon=HORIZON,
        evaluation_horizon=HORIZON,
        chunk_size=chunk_size,
    )
    with make_backend(partial(RolloutWorker, plan)) as backend:
        return list(itertools.islice(evolve(state, settings, table, backend), generations))


def _run_bits(reports):
    return [
        (
            _state_bits(report.state),
            *(
                a.tobytes()
                for a in (report.results.returns, report.results.score, report.results.success, report.results.steps,
                          report.results.has_terminated, report.results.has_diverged)
            ),
        )
        for report in reports
    ]  # fmt: skip


@pytest.fixture(scope="module")
def serial_run(table):
    return _point_gather_run(SerialBackend, table, chunk_size=1)


@pytest.mark.parametrize("chunk_size", [0, 2, 5])
def test_the_number_of_members_in_lockstep_changes_no_bit(table, serial_run, chunk_size):
    assert _run_bits(_point_gather_run(SerialBackend, table, chunk_size=chunk_size)) == _run_bits(serial_run)


# Of 8 members, 2 workers get whole policies, 3 workers also single episodes.
@pytest.mark.parametrize("workers", [2, 3])
def test_worker_processes_change_no_bit(table, serial_run, workers):
    reports = _point_gather_run(partial(ProcessesBackend, num_workers=workers), table, chunk_size=2)
    assert _run_bits(reports) == _run_bits(serial_run)


def test_generations_on_point_gather_do_something(serial_run):
    assert [report.state.generation for report in serial_run] == [1, 2, 3]
    steps = [int(report.results.steps.sum()) for report in serial_run]
    assert steps == [8 * EPISODES * HORIZON] * 3  # a point cannot fall
    assert [report.state.env_steps for report in serial_run] == list(itertools.accumulate(steps))
    for report in serial_run:
        assert np.ptp(report.results.fitness[PRIMITIVE]) > 0
    thetas = [level.theta.tobytes() for report in serial_run for level in report.state.levels]
    assert len(set(thetas)) == 6


def test_statistics_count_steps_and_decisions(serial_run):
    for number, report in enumerate(serial_run, start=1):
        controller, primitive = (level.statistics for level in report.state.levels)
        assert primitive.count == report.state.env_steps
        assert controller.count == number * 8 * EPISODES * 4  # decisions at 0, 8, 16, 24


def test_without_a_share_for_statistics_they_stay_empty(table):
    reports = _point_gather_run(
        SerialBackend, table, settings=replace(SETTINGS, statistics_fraction=0.0), generations=2
    )
    for level in reports[-1].state.levels:
        assert level.statistics.count == 0
        assert not level.statistics.total.any()
