"""`evolve` with every option: the same bits on any workers, in any lockstep, and from any generation on."""

import itertools
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from shes.algorithms.evolution.algorithm import evolve
from shes.algorithms.worker import RolloutWorker, WorkerPlan
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.envs.registry import find_environment, make_task
from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS, OneToMany
from shes.es.shaping import FITNESS_SHAPINGS, PairRanks
from shes.hierarchy.flat import FlatDesign
from shes.hierarchy.goals import AngleEncoding, MetreAngleEncoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.intervals import IntervalEstimate
from shes.hierarchy.outputs import HeadingVectorOutput, VectorOutput
from shes.hierarchy.population_tasks import COMMON_RANDOM_NUMBERS
from shes.hierarchy.primitive import BranchDesign, PrimitiveDesign
from shes.hierarchy.rewards import MetresReward, ProgressReward
from shes.hierarchy.views import ColumnsView, EgocentricView
from shes.options import make
from shes.policies.mlp import MLP
from tests.hierarchy import designs
from tests.hierarchy.formula import EPISODES, SETTINGS, changing, constant, run_bits, start_state
from tests.hierarchy.workers import AnyWorker, fake_plan

GENERATIONS = 3


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


# The runs: agents on tasks without physics with every option, and each kind of agent on a point robot ----------------

FAKES = {
    "both": (designs.hierarchical(), 0),
    "one hot, clock": (designs.hierarchical("vector", "one_hot", designs.CLOCK, "picked", reward="cosine"), 0),
    "primitive": (designs.primitive("unit_vector"), designs.INTERVAL),
    "flat": (designs.flat(designs.CLOCK), 0),
}
"""Agents, and after how many steps their environment moves the goals that it sets."""

FAKE = replace(SETTINGS, episodes_per_policy=2)
SINGLE = replace(SETTINGS, updates=SETTINGS.updates[:1], learns=(True,))
"""Settings for one level."""
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
        f"{design}, {name}": (design, replace(FAKE, **{"updates": FAKE.updates[:1], "learns": (True,), **options}))
        for design in ("primitive", "flat")
        for name, options in ONE_LEVEL.items()
    },
}
HORIZON = 30


def _hierarchical_point():
    """Return environment and design of a controller and a primitive that collect food."""
    task = make_task("point-gather", 1)
    return "point-gather", HierarchicalDesign(
        controller=MLP(task.observation_size, (8,), 2),
        primitive=MLP(3 + task.observation_size, (8,), task.action_size),
        controller_output=VectorOutput(),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        goal_distance=4.0,
        controller_interval=8,
        has_minimum_goal_distance=True,
        control_limit=task.control_limit,
    )


def _flat_point():
    task = make_task("point-gather", 1)
    policy = MLP(task.observation_size, (8,), task.action_size)
    return "point-gather", FlatDesign(policy=policy, control_limit=task.control_limit)


def _primitive_point():
    task = make_task("point-flagrun", 1)
    view = tuple(task.proprioception.tolist())
    return "point-flagrun", PrimitiveDesign(
        primitive=MLP(3 + len(view), (9,), task.action_size),
        primitive_view=ColumnsView(view),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_interval=8,
        control_limit=task.control_limit,
    )


def _branched_point():
    """Return environment and design of a primitive that is judged by intervals beside a controller."""
    task = make_task("point-push", 1)
    view = EgocentricView(task.robot, task.proprioception.tolist())
    return "point-push", HierarchicalDesign(
        controller=MLP(task.observation_size, (7,), 2),
        primitive=MLP(3 + view.size(task.observation_size), (7,), task.action_size),
        primitive_view=view,
        controller_output=HeadingVectorOutput(),
        goal_encoding=MetreAngleEncoding(),
        primitive_reward=MetresReward(),
        goal_distance=4.0,
        controller_interval=8,
        has_minimum_goal_distance=False,
        control_limit=task.control_limit,
    )


def _running_point():
    """Return environment and design of a primitive alone whose episodes run from generation to generation."""
    env, design = _primitive_point()
    return env, replace(design, primitive=MLP(design.primitive.sizes[0], (10,), 2))


def _estimate(**changes):
    """Return how a primitive of these runs is judged by intervals; its episodes are over in the third generation."""
    numbers = {"population_size": 12, "intervals": 2, "controller_interval": 8, "horizon": 32, "goal_distance": 4.0}
    rule = UpdateRule(shaping=PairRanks(), fall_price=0.5)
    rates = {"sigma": constant(0.1), "learning_rate": constant(0.03)}
    return IntervalEstimate(update=rule, **{**numbers, **rates, **changes})


POINTS = {
    "point, both": (_hierarchical_point, SETTINGS),
    "point, primitive": (_primitive_point, SINGLE),
    "point, flat": (_flat_point, SINGLE),
    "point, branches": (_branched_point, replace(SETTINGS, intervals=_estimate(), horizon=HORIZON)),
    "point, running": (_running_point, replace(SINGLE, intervals=_estimate())),
}


def _point_plan(of, table, chunk_size):
    env, design = of()
    options = {"controller_interval": 8} if env == "point-flagrun" else {}
    return WorkerPlan(
        env=find_environment(env),
        training=find_environment(env).options(**options),
        evaluation=find_environment(env).options(evaluation=True, **options),
        design=design,
        noise_table=table.path,
        horizon=HORIZON,
        evaluation_horizon=HORIZON,
        chunk_size=chunk_size,
        branch_design=_branches_of(design) if of is _branched_point else None,
    )


def _branches_of(design):
    """Return what acts in the branches of a `design` with a controller."""
    return BranchDesign(num_goals=2, **{field.name: getattr(design, field.name) for field in fields(PrimitiveDesign)})


def _design_and_settings(case):
    if case in POINTS:
        of, settings = POINTS[case]
        return of()[1], settings
    fake, settings = CASES[case]
    return FAKES[fake][0], settings


def _state(case):
    """Return the state before the first generation."""
    design, settings = _design_and_settings(case)
    rng = np.random.default_rng(0)
    thetas = [policy.initial(rng, "glorot_normal") for policy in design.policies]
    return start_state(thetas, design.observation_sizes, settings=settings, names=design.level_names)


def _run(case, table, backend, state=None, generations=GENERATIONS):
    _, settings = _design_and_settings(case)
    return list(itertools.islice(evolve(state or _state(case), settings, table, backend), generations))


def _make_worker(table, of_points, of_fakes):
    """Return a maker of workers that run so many members at a time."""
    plans = [_point_plan(of, table, of_points) for of, _ in POINTS.values()]
    fakes = [
        fake_plan(design, table, goal_interval=every, horizon=6, chunk_size=of_fakes)
        for design, every in FAKES.values()
    ]
    return partial(AnyWorker, plans + fakes)


@pytest.fixture(scope="module")
def serial(table):
    """One worker in this process: a point at a time, four members on tasks without physics."""
    with SerialBackend(_make_worker(table, 1, 4)) as backend:
        yield backend


@pytest.fixture(scope="module")
def expected(table, serial):
    """Return the run of a case on one worker, made when first asked for."""
    made = {}

    def get(case):
        if case not in made:
            made[case] = _run(case, table, serial)
        return made[case]

    return get


@pytest.fixture(scope="module")
def lockstep(table):
    """Three workers' share of the work, cut as for them, in this process; up to eight members at a time."""
    with SerialBackend(_make_worker(table, 8, 8)) as backend:
        backend.num_workers = 3
        yield backend


# Of 8 members, 2 workers get whole policies, 3 workers also single episodes.
@pytest.fixture(
    scope="module", params=[pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.extras), 3]
)
def processes(request, table):
    """Worker processes that run up to three members at a time."""
    with ProcessesBackend(_make_worker(table, 3, 3), request.param) as backend:
        yield backend


QUICK = (
    "point, both",
    "point, branches",
    "point, running",
    "everything",
    "primitive, schedule",
    "flat, schedule",
)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=() if case in QUICK else pytest.mark.slow) for case in (*POINTS, *CASES)],
)
def test_the_number_of_worker_processes_changes_no_bit(table, case, processes, expected):
    assert run_bits(_run(case, table, processes)) == run_bits(expected(case))


@pytest.mark.parametrize("case", [*CASES, "point, branches", "point, running"])
@pytest.mark.parametrize("stop", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_goes_on_with_other_workers_as_if_it_had_not_stopped(table, case, stop, lockstep, expected):
    whole = expected(case)
    rest = _run(case, table, lockstep, whole[stop - 1].state, GENERATIONS - stop)
    assert run_bits(rest) == run_bits(whole[stop:])


@pytest.mark.parametrize(
    ("case", "chunk_size"),
    [
        ("point, both", 0),
        ("point, both", 5),
        ("point, primitive", 5),
        ("point, flat", 0),
        ("point, branches", 0),
        ("point, branches", 5),
        ("point, running", 5),
        *(
            pytest.param(*each, marks=pytest.mark.extras)
            for each in (("point, both", 2), ("point, branches", 2), ("point, running", 0), ("point, running", 2))
        ),
    ],
)
def test_the_number_of_members_in_lockstep_changes_no_bit(table, case, chunk_size, expected):
    of, _ = POINTS[case]
    with SerialBackend(partial(RolloutWorker, _point_plan(of, table, chunk_size))) as backend:
        assert run_bits(_run(case, table, backend)) == run_bits(expected(case))


# What the runs above do, so that they say something -------------------------------------------------------------------


def test_every_option_changes_numbers(expected):
    """Otherwise an option that nobody looks at would pass all tests here."""
    ends = {case: [level.theta.tobytes() for level in expected(case)[-1].state.levels] for case in CASES}
    for one, other in itertools.combinations(CASES, 2):
        assert ends[one] != ends[other], (one, other)


def test_levels_that_learn_move_with_every_option(expected):
    for case in [*POINTS, *CASES]:
        _, settings = _design_and_settings(case)
        for before, after, learns in zip(
            _state(case).levels, expected(case)[-1].state.levels, settings.learns, strict=True
        ):
            assert np.array_equal(before.theta, after.theta) != learns, case
            assert after.name == before.name


def test_generations_on_a_point_do_something(expected):
    for case in POINTS:
        run, (_, settings) = expected(case), _design_and_settings(case)
        assert [report.state.generation for report in run] == [1, 2, 3]
        steps = [report.num_steps for report in run]
        branches = 0 if settings.intervals is None else settings.intervals.population_size * 16
        whole = 0 if case == "point, running" else 8 * EPISODES * HORIZON
        assert steps == [whole + branches] * 3  # a point cannot fall
        assert [report.state.env_steps for report in run] == list(itertools.accumulate(steps))
        for report in run:
            assert np.ptp(report.results.fitness[-1]) > 0
            observed = report.state.generation * (branches or whole)
            assert report.state.levels[-1].statistics.count == observed
        thetas = [level.theta.tobytes() for report in run for level in report.state.levels]
        assert len(set(thetas)) == len(thetas) == 3 * len(run[0].state.levels)


def test_statistics_count_steps_and_decisions(expected):
    for number, report in enumerate(expected("point, both"), start=1):
        controller, primitive = (level.statistics for level in report.state.levels)
        assert primitive.count == report.state.env_steps
        assert controller.count == number * 8 * EPISODES * 4  # decisions at 0, 8, 16, 24


def test_without_a_share_for_statistics_they_stay_empty(table, serial):
    settings = replace(SETTINGS, statistics_fraction=0.0)
    reports = list(itertools.islice(evolve(_state("point, both"), settings, table, serial), 2))
    for level in reports[-1].state.levels:
        assert level.statistics.count == 0
        assert not level.statistics.total.any()
