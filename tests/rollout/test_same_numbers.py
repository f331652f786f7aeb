"""`evolve` with every option: the same bits on any workers, in any lockstep, and from any generation on."""

import itertools
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.backends.processes import ProcessesBackend
from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS, OneToMany
from shes.es.shaping import FITNESS_SHAPINGS
from shes.evolution.algorithm import evolve, num_steps
from shes.evolution.estimates import COMMON_RANDOM_NUMBERS
from shes.options import make
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.rollout import designs
from tests.rollout.formula import SETTINGS, bits, changing, start_state
from tests.rollout.workers import AnyWorker, fake_plan

GENERATIONS = 3
TABLE_SIZE = 50_000

# Agents on tasks without physics with every option --------------------------------------------------------------------

FAKES = {
    "both": (designs.both(), 0),
    "one hot, clock": (designs.both("one_hot", encoding="vector", reward="cosine", clock=designs.CLOCK), 0),
    "alone": (designs.primitive("unit_vector"), designs.INTERVAL),
    "flat": (designs.flat(designs.CLOCK), 0),
}
"""Agents, and after how many steps their environment moves the goals that it sets."""
FAKE = replace(SETTINGS, episodes_per_policy=2)
RULES = {
    **{name: UpdateRule(shaping=make(FITNESS_SHAPINGS, name, {})) for name in FITNESS_SHAPINGS},
    **{name: UpdateRule(optimizer=OPTIMIZERS.find(name)(), weight_decay=0.01) for name in OPTIMIZERS},
}
OPTIONS = {
    **{name: {"updates": (rule, rule)} for name, rule in RULES.items()},
    "pair_rank": {"updates": (RULES["pair_rank"],) * 2, "mirrored": "pair"},
    **{name: {"perturbation": PERTURBATIONS.find(name)()} for name in PERTURBATIONS if name != "many_to_many"},
    **{f"{name} mirroring": {"mirrored": name} for name in ("pair", "none")},
    **{f"{name} common numbers": {"common_random_numbers": name} for name in COMMON_RANDOM_NUMBERS if name != "group"},
    "schedules": {
        "sigma": changing(0.1, 0.02, 3),
        "learning_rate": changing(0.05, 0.01, 2),
    },
    "three episodes": {"episodes_per_policy": 3},
    "some statistics": {"statistics_fraction": 0.5},
    "no statistics": {"statistics_fraction": 0.0},
    "frozen primitive": {"learns": (True, False)},
    "frozen controller": {"learns": (False, True)},
    "everything": {
        "sigma": changing(0.1, 0.05, 3),
        "episodes_per_policy": 3,
        "updates": (RULES["centred_rank"], RULES["sgd"]),
        "perturbation": OneToMany(),
        "common_random_numbers": "population",
        "statistics_fraction": 0.5,
    },
}
ONE_LEVEL = {
    "plain": {},
    "no mirroring, own episodes": {"mirrored": "none", "common_random_numbers": "off"},
    "schedule": {"sigma": changing(0.2, 0.05, 2)},
}
CASES = {
    **{name: ("both", replace(FAKE, **options)) for name, options in OPTIONS.items()},
    "one hot, clock": ("one hot, clock", FAKE),
    **{
        f"{design}, {name}": (design, replace(FAKE, updates=FAKE.updates[:1], learns=(True,), **options))
        for design in ("alone", "flat")
        for name, options in ONE_LEVEL.items()
    },
}

# Each kind of agent on a point robot ----------------------------------------------------------------------------------

BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric", "sigma": 0.1}
POINTS = {
    "point, both": ("point-gather", {"hidden": (8,)}),
    "point, alone": ("point-flagrun", {"hidden": (9,)}),
    "point, flat": ("point-gather", {"hidden": (8,), "algorithm": "es"}),
    "point, branches": ("point-push", {"hidden": (7,), "primitive_population_size": 12, "fall_price": 0.5, **BRANCHES}),
    "point, running": ("point-flagrun", {"hidden": (12,), "population_size": 12, "horizon": 32, **BRANCHES}),
}
"""The episodes of the last one are over after the second generation."""
OF_POINTS = {"population_size": 8, "horizon": 30, "episodes_per_policy": 3, "noise_table_size": TABLE_SIZE}


@lru_cache
def point(case, chunk_size=1):
    """Return the learner of a case."""
    env, settings = POINTS[case]
    goals = {} if "algorithm" in settings else {"controller_interval": 8}
    whole = {name: value for name, value in OF_POINTS.items() if case != "point, running" or name[0] != "e"}
    return build_algorithm(make_config(env, "smoke", {**whole, **goals, **settings, "chunk_size": chunk_size}))


def start(case):
    """Return the state before the first generation, and the settings."""
    if case in POINTS:
        return point(case).start(3), point(case).hyperparameters
    design, settings = FAKES[CASES[case][0]][0], CASES[case][1]
    rng = np.random.default_rng(0)
    thetas = [policy.initial(rng, "glorot_normal") for policy in design.policies]
    return start_state(thetas, design.observation_sizes, settings=settings, names=design.level_names), settings


def run(case, table, backend, state=None, generations=GENERATIONS):
    first, settings = start(case)
    return list(itertools.islice(evolve(state or first, settings, table, backend), generations))


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(TABLE_SIZE)


def make_worker(table, of_points, of_fakes):
    """Return a maker of workers that run so many members at a time."""
    fakes = [
        fake_plan(design, table, goal_interval=every, horizon=6, chunk_size=of_fakes)
        for design, every in FAKES.values()
    ]
    return partial(AnyWorker, [point(case, of_points).plan() for case in POINTS] + fakes)


@pytest.fixture(scope="module")
def expected(table):
    """Return the run of a case on one worker, made when first asked for: a point at a time, four fake members."""
    with SerialBackend(make_worker(table, 1, 4)) as backend:
        yield lru_cache(lambda case: run(case, table, backend))


@pytest.fixture(scope="module")
def lockstep(table):
    """Three workers' share of the work, cut as for them, in this process; up to eight members at a time."""
    with SerialBackend(make_worker(table, 8, 8)) as backend:
        backend.num_workers = 3
        yield backend


# Of 8 members, 2 workers get whole policies, 3 workers also single episodes.
@pytest.fixture(
    scope="module", params=[pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.extras), 3]
)
def processes(request, table):
    """Worker processes that run up to three members at a time."""
    with ProcessesBackend(make_worker(table, 3, 3), request.param) as backend:
        yield backend


QUICK = ("point, both", "point, branches", "point, running", "everything", "alone, schedule", "flat, schedule")


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=() if case in QUICK else pytest.mark.slow) for case in (*POINTS, *CASES)]
)
def test_the_number_of_worker_processes_changes_no_bit(table, case, processes, expected):
    assert bits(run(case, table, processes)) == bits(expected(case))


@pytest.mark.parametrize("case", [*CASES, *POINTS])
@pytest.mark.parametrize("stop", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_goes_on_on_other_workers_as_if_it_had_not_stopped(table, case, stop, lockstep, expected):
    whole = expected(case)
    state, settings = start(case)
    for before, after, learns in zip(state.levels, whole[-1].state.levels, settings.learns, strict=True):
        assert np.array_equal(before.theta, after.theta) != learns  # otherwise the comparison would say nothing
    rest = run(case, table, lockstep, whole[stop - 1].state, GENERATIONS - stop)
    assert bits(rest) == bits(whole[stop:])


@pytest.mark.parametrize("case", POINTS)
@pytest.mark.parametrize("chunk_size", [0, pytest.param(2, marks=pytest.mark.extras), 5])
def test_the_number_of_members_in_lockstep_changes_no_bit(table, case, chunk_size, expected):
    with SerialBackend(partial(RolloutWorker, point(case, chunk_size).plan())) as backend:
        assert bits(run(case, table, backend)) == bits(expected(case))


# What the runs above do, so that they say something -------------------------------------------------------------------


@pytest.mark.parametrize("case", POINTS)
def test_generations_on_a_point_do_something(case, expected):
    run, settings = expected(case), start(case)[1]
    branches = 0 if settings.intervals is None else 12 * 16
    whole = 0 if case == "point, running" else 8 * 3 * 30
    steps = [num_steps(report.populations) for report in run]
    assert steps == [whole + branches] * 3  # a point cannot fall
    assert [report.state.env_steps for report in run] == list(itertools.accumulate(steps))
    for number, report in enumerate(run, start=1):
        assert report.state.generation == number
        assert np.ptp(report.populations[-1].results.fitness[-1]) > 0
        assert report.state.levels[-1].statistics.count == number * (branches or whole)
        if len(report.state.levels) == 2:
            assert report.state.levels[0].statistics.count == number * 8 * 3 * 4  # decisions at 0, 8, 16, 24
    is_never = case != "point, running"
    assert [report.state.running is None for report in run] == [is_never, True, is_never]
