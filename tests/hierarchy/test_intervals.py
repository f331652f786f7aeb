"""Primitives that are judged by intervals: their pairs, where these begin, what goes on, and what counts."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from shes.algorithms.evolution.algorithm import evolve
from shes.algorithms.evolution.populations import generation_work, roll_out, roll_out_branches
from shes.algorithms.worker import RolloutWorker
from shes.backends.serial import SerialBackend
from shes.es.level import RunningEpisodes, UpdateRule, draw_noise_index
from shes.es.shaping import PairRanks
from shes.hierarchy.episodes import Snapshot
from shes.hierarchy.intervals import IntervalEstimate, branch_work, draw_snapshot_steps, next_running
from shes.hierarchy.primitive import BranchDesign, PrimitiveDesign
from shes.hierarchy.results import PopulationResults
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config
from tests.hierarchy import designs
from tests.hierarchy.formula import SETTINGS, changing, constant, formula_state, start_state
from tests.hierarchy.plain_loop import play

PAIRS = 6
STEPS = 5
"""Control steps of an interval."""
HORIZON = 23
"""Control steps of an episode: the last interval is cut short."""
TABLE_SIZE = 1000


def _estimate(**changes):
    settings = {
        "population_size": 2 * PAIRS,
        "intervals": 2,
        "controller_interval": STEPS,
        "horizon": HORIZON,
        "goal_distance": 4.0,
        "update": UpdateRule(shaping=PairRanks()),
        "sigma": changing(0.2, 0.1, 2),
        "learning_rate": constant(0.03),
    }
    return IntervalEstimate(**{**settings, **changes})


def _alone(seed=3, running=None, generation=0):
    """Return the state of a primitive alone."""
    settings = replace(SETTINGS, updates=SETTINGS.updates[:1], learns=(True,))
    theta = np.arange(7, dtype=np.float32)
    state = start_state([theta], (3,), seed=seed, settings=settings, names=("primitive",))
    return replace(state, running=running, generation=generation)


def _snapshot(number, size=4):
    return Snapshot(state=np.full(size, float(number)), steps=STEPS * number, goals=np.full((2, 2), number / 10))


def _task_bits(work):
    return [
        (task.member, task.noise_index, task.signs, task.seeds, task.kept_slot, _start_bits(task.start))
        for task in work.tasks
    ]


def _start_bits(start):
    if start is None:
        return None
    return None if start.state is None else start.state.tobytes(), start.steps, start.goals.tobytes()


# The pairs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("left", [None, [_snapshot(n) for n in range(9)], []], ids=["running", "left", "none left"])
def test_a_task_is_a_mirrored_pair_with_one_noise_one_seed_and_one_start(left):
    state, estimate = formula_state(), _estimate()
    work = branch_work(state, estimate, TABLE_SIZE, left)
    assert work.signs.tolist() == [[[1], [-1]]] * PAIRS
    assert work.noise_index.shape == (1, PAIRS)
    assert [task.member for task in work.tasks] == [0, 2, 4, 6, 8, 10]
    for group, task in enumerate(work.tasks):
        assert (task.signs, task.slots) == (((1,), (-1,)), (0, 1))
        assert task.noise_index == (work.noise_index[0, group],)
        assert task.seeds[0] == task.seeds[1]
        assert task.records_statistics
        assert task.snapshot_steps == ()
    assert len({task.noise_index for task in work.tasks}) == len({task.seeds for task in work.tasks}) == PAIRS
    generation = work.generation
    assert (generation.members_per_lane, generation.episodes_per_policy, generation.rows_per_lane) == (2, 1, 2)
    assert (generation.branch_steps, generation.kind) == (2 * STEPS, "branch")
    assert [level.theta.tobytes() for level in generation.levels] == [state.levels[-1].theta.tobytes()]


def test_pairs_take_their_noise_from_the_stream_of_the_primitives_level():
    """Beside a controller the primitive is level 1: neither level's noise says anything of the other's."""
    state = formula_state()
    work = branch_work(state, _estimate(), TABLE_SIZE, [])
    dims = tuple(len(level.theta) for level in state.levels)
    whole = draw_noise_index(state.seed, 0, PAIRS, dims, TABLE_SIZE)
    assert work.noise_index.tolist() == whole[1:].tolist() != whole[:1].tolist()
    alone = branch_work(_alone(), _estimate(), TABLE_SIZE)
    assert alone.noise_index.tolist() == draw_noise_index(3, 0, PAIRS, (7,), TABLE_SIZE).tolist()


def test_pairs_are_as_far_from_the_mean_as_the_schedule_says():
    sigmas = [branch_work(_alone(generation=g), _estimate(), TABLE_SIZE).generation.sigma for g in range(4)]
    assert sigmas == pytest.approx([0.2, 0.15, 0.1, 0.1])


def test_pairs_depend_on_the_seed_and_the_generation_and_on_nothing_else():
    left = [_snapshot(n) for n in range(9)]

    def bits(state, estimate=None):
        return _task_bits(branch_work(state, estimate or _estimate(), TABLE_SIZE, left))

    assert bits(_alone()) == bits(_alone()) == bits(_alone(), _estimate(sigma=constant(9.0)))
    others = [bits(_alone(seed=4)), bits(_alone(generation=1))]
    for other in others:
        for i in (1, 3):  # noise and seeds
            assert not {task[i] for task in other} & {task[i] for task in bits(_alone())}
        assert [task[5] for task in other] != [task[5] for task in bits(_alone())]


def test_episodes_that_run_on_keep_either_side_and_others_keep_none():
    kept = [task.kept_slot for g in range(8) for task in branch_work(_alone(generation=g), _estimate(), 999).tasks]
    assert set(kept) == {0, 1}
    assert abs(np.mean(kept) - 0.5) < 0.25
    left = branch_work(formula_state(), _estimate(), TABLE_SIZE, [_snapshot(1)])
    assert {task.kept_slot for task in left.tasks} == {None}


# Where they begin ----------------------------------------------------------------------------------------------------


def test_the_first_pairs_begin_at_a_reset():
    assert {task.start for task in branch_work(_alone(), _estimate(), TABLE_SIZE).tasks} == {None}


def test_pairs_begin_where_the_running_episodes_are():
    states = np.random.default_rng(0).normal(size=(PAIRS, 4))
    running = RunningEpisodes(states=states, steps=np.array([10, -1, 20, 10, -1, 10]))
    starts = [task.start for task in branch_work(_alone(running=running), _estimate(), TABLE_SIZE).tasks]
    assert [start is None for start in starts] == [False, True, False, False, True, False]
    for group, start in enumerate(starts):
        if start is not None:
            assert (start.state.tobytes(), start.steps) == (states[group].tobytes(), running.steps[group])
            assert start.goals.shape == (0, 2)  # the environment sets them


@pytest.mark.parametrize(("number", "times"), [(1, {6}), (2, {3}), (4, {1, 2}), (6, {1}), (40, {1})])
def test_snapshots_are_used_as_often_as_it_takes_and_as_evenly_as_it_goes(number, times):
    left = [_snapshot(n) for n in range(number)]
    starts = [task.start for task in branch_work(formula_state(), _estimate(), TABLE_SIZE, left).tasks]
    assert all(any(start is each for each in left) for start in starts)
    counts = np.bincount([start.steps // STEPS for start in starts], minlength=number)
    assert set(counts[counts > 0]) == times
    assert (counts > 0).sum() == min(number, PAIRS)
    if number == 40:  # not always the first ones
        others = branch_work(replace(formula_state(), generation=1), _estimate(), TABLE_SIZE, left).tasks
        assert {task.start.steps for task in others} != {start.steps for start in starts} != set(range(0, 30, 5))


def test_where_no_episode_left_anything_pairs_begin_at_a_reset_on_drawn_goals():
    starts = [
        task.start
        for generation in range(20)
        for task in branch_work(replace(formula_state(), generation=generation), _estimate(), TABLE_SIZE, []).tasks
    ]
    assert {(start.state, start.steps, start.goals.shape) for start in starts} == {(None, 0, (2, 2))}
    goals = np.array([start.goals for start in starts])
    assert len(np.unique(goals)) == goals.size
    assert 3.9 < np.abs(goals).max() <= 4
    assert np.abs(goals.mean(axis=0)).max() < 0.7


# What goes on --------------------------------------------------------------------------------------------------------


def _results(ends):
    """Return results of pairs in which these members left snapshots."""
    results = PopulationResults.empty(1, 2 * PAIRS, 1)
    results.snapshots.update({(member, 0): end for member, end in ends.items()})
    return results


def test_an_episode_goes_on_from_the_side_that_was_kept():
    running = next_running(_results({0: _snapshot(1), 5: _snapshot(2), 10: _snapshot(3)}), _estimate())
    assert running.steps.tolist() == [5, -1, 10, -1, -1, 15]
    assert running.states.shape == (PAIRS, 4)
    assert [row[0] for row in running.states] == [1, 0, 2, 0, 0, 3]


@pytest.mark.parametrize(("steps", "goes_on"), [(HORIZON - 1, True), (HORIZON, False), (HORIZON + 4, False)])
def test_an_episode_begins_anew_at_its_horizon(steps, goes_on):
    end = replace(_snapshot(1), steps=steps)
    running = next_running(_results({2: end, 4: _snapshot(1)}), _estimate())
    assert running.steps.tolist() == [-1, steps if goes_on else -1, 5, -1, -1, -1]


def test_nothing_goes_on_where_all_have_ended():
    assert next_running(_results({}), _estimate()) is None
    assert next_running(_results({3: replace(_snapshot(1), steps=HORIZON)}), _estimate()) is None


@pytest.mark.parametrize(("horizon", "decisions"), [(23, 5), (25, 5), (26, 6), (3, 1)])
def test_whole_episodes_leave_snapshots_at_any_of_their_decisions(horizon, decisions):
    steps = draw_snapshot_steps(_alone(), 400, horizon, STEPS)
    assert len(steps) == 400
    assert set(steps) == {STEPS * number for number in range(decisions)}
    assert steps == draw_snapshot_steps(_alone(), 400, horizon, STEPS)
    if decisions > 1:
        assert steps != draw_snapshot_steps(_alone(generation=1), 400, horizon, STEPS)
        assert steps != draw_snapshot_steps(_alone(seed=4), 400, horizon, STEPS)


# Agents in branches --------------------------------------------------------------------------------------------------


def test_an_agent_in_a_branch_pursues_the_goals_in_order_from_where_its_robots_are():
    primitive = designs.primitive(clock=designs.CLOCK)
    shared = {field.name: getattr(primitive, field.name) for field in fields(PrimitiveDesign)}
    agent = BranchDesign(num_goals=2, **shared).make(2, 3)
    rng = np.random.default_rng(1)
    goals = rng.uniform(-4, 4, (2, 2, 2))
    for episode in range(2):  # a lane forgets what it pursued before
        agent.start(slice(None))
        for lane, steps in enumerate((2 * designs.INTERVAL, 0)):
            agent.go_on(lane, steps, goals[lane])
        assert agent.clock.tolist() == [2 * designs.INTERVAL, 0]
        held = []
        for step in range(3 * designs.INTERVAL):
            position = rng.uniform(-9, 9, (6, 2))
            agent.act(rng.normal(size=(6, designs.OBSERVED)), position, np.zeros(6), goal=np.full((6, 2), 99.0))
            number, is_new = divmod(step, designs.INTERVAL)
            if not is_new:
                held.append(position + np.repeat(goals[:, min(number, 1)], 3, axis=0))
            assert agent.goal.tolist() == held[-1].tolist(), episode


def test_a_lane_that_starts_later_begins_with_its_own_first_goal():
    """Its decisions are not those of the others, whose goals go on as they were."""
    shared = {field.name: getattr(designs.primitive(), field.name) for field in fields(PrimitiveDesign)}
    agent = BranchDesign(num_goals=3, **shared).make(2, 1)
    goals = np.array([[number, 0.5] for number in range(1, 7)])
    agent.start(slice(None))
    agent.go_on(0, 0, goals[:3])
    agent.go_on(1, 0, goals[:3])
    seen, late = [], 2
    for step in range(3 * designs.INTERVAL):
        if step == late:
            agent.start(np.array([1]))
            agent.go_on(1, 0, goals[3:])
        agent.act(np.zeros((2, designs.OBSERVED)), np.zeros((2, 2)), np.zeros(2))
        seen.append(agent.goal[:, 0].tolist())
    held = designs.INTERVAL
    assert [row[0] for row in seen] == [1] * held + [2] * held + [3] * held
    assert [row[1] for row in seen] == [1] * late + [4] * held + [5] * held + [6] * (held - late)


# On the ant ----------------------------------------------------------------------------------------------------------

ANT = {
    "population_size": 16,
    "hidden": (6,),
    "horizon": HORIZON,
    "controller_interval": STEPS,
    "primitive_view": "egocentric",
    "symmetry": "dihedral",
    "primitive_estimate": "interval",
    "reset_noise": 0.6,  # some are in the air, or on their backs: they fall sooner or later
    "sigma": 0.3,
    "clock_frequency": 1.3,  # goes on in a branch from where its episode was
    "chunk_size": 4,  # lanes are used again, out of step with each other
}
BESIDE = {"primitive_population_size": 12, "primitive_sigma": 0.2, "primitive_learning_rate": 0.07}


class Case:
    """A run on the ant, with what its generations are made of."""

    def __init__(self, env, settings):
        config = make_config(env, "smoke", settings)
        learner = build_algorithm(config)
        self.design, self.settings = learner.design, learner.hyperparameters
        self.table, self.state, self.plan = learner.table, learner.start(config.run.seed), learner.plan()
        self.backend = SerialBackend(partial(RolloutWorker, self.plan))

    def play(self, task, generation):
        """Play the episodes of `task` by a plain loop."""
        design = self.plan.branch_design if generation.branch_steps and self.plan.branch_design else self.design
        horizon = generation.branch_steps or HORIZON
        return play(
            design, partial(self.plan.env.make, options=self.plan.training), task, generation, self.table, horizon
        )

    def check(self, population):
        """Compare what came of every task with the plain loop; return what that saw, by the task's first member."""
        found, results = {}, population.results
        for task in population.work.tasks:
            played = self.play(task, population.work.generation)
            members = slice(task.member, task.member + len(task.slots))
            assert results.steps[members, 0].tolist() == played.steps.tolist()
            assert results.returns[-1, members, 0].tobytes() == played.returns.tobytes()
            assert results.has_fallen[members, 0].tolist() == played.fell.tolist()
            assert results.final_position[members, 0].tobytes() == played.positions.tobytes()
            found[task.member] = played
        return found


@pytest.fixture(scope="module")
def beside():
    """A controller, with a primitive that pairs on branches judge."""
    case = Case("ant-gather", {**ANT, **BESIDE})
    with case.backend:
        yield case


@pytest.fixture(scope="module")
def alone():
    """A primitive whose episodes run from generation to generation."""
    case = Case("ant-flagrun", {**ANT, "hold_tied": False})
    with case.backend:
        yield case


@pytest.fixture(scope="module")
def whole(beside):
    """The whole episodes of the first generation."""
    return roll_out(beside.state, beside.settings, beside.table, beside.backend)


def test_a_snapshot_is_the_state_at_its_decision_with_the_goals_that_the_controller_set_then(beside, whole):
    played, snapshots, seen = beside.check(whole), whole.results.snapshots, []
    for task in whole.work.tasks:
        for slot, wanted in zip(task.slots, task.snapshot_steps, strict=True):
            run = played[task.member]
            lived = run.steps[slot] > wanted
            assert ((task.member + slot, 0) in snapshots) == lived
            if not lived:
                seen.append("none")
                continue
            left = snapshots[task.member + slot, 0]
            assert left.steps == wanted
            assert left.state.tobytes() == run.states[wanted][slot].tobytes()
            next_decision = wanted + STEPS
            goals = [run.goals[wanted][slot]]
            goals.append(run.goals[next_decision][slot] if run.steps[slot] > next_decision else goals[0])
            seen.append("both" if goals[1] is not goals[0] else "fell" if run.fell[slot] else "over")
            assert left.goals.tobytes() == np.array(goals).tobytes()
    assert set(seen) == {"none", "both", "fell", "over"}  # every way to live


def test_a_snapshot_at_the_first_decision_is_the_start_itself(whole):
    assert min(left.steps for left in whole.results.snapshots.values()) == 0
    assert max(left.steps for left in whole.results.snapshots.values()) == 20


def test_a_branch_is_what_a_plain_loop_makes_of_its_start(beside, whole):
    branches = roll_out_branches(beside.state, beside.settings, beside.table, beside.backend, whole)
    left = {id(each) for each in whole.results.snapshots.values()}
    assert {id(task.start) for task in branches.work.tasks} <= left
    assert branches.results.snapshots == {}
    played = beside.check(branches)
    for task in branches.work.tasks:
        run = played[task.member]
        assert run.states[0].tobytes() == np.tile(task.start.state, (2, 1)).tobytes()
        assert run.goals[0] == pytest.approx(np.tile(task.start.goals[0], (2, 1)), abs=1e-12)
    assert np.ptp(branches.results.returns[0].reshape(-1, 2), axis=1).all()  # the two sides differ
    assert branches.rules == (beside.settings.intervals.update,)
    assert (branches.work.generation.sigma, branches.learning_rate) == (0.2, 0.07)
    assert (whole.work.generation.sigma, whole.learning_rate) == (0.3, 0.01)


def test_in_whole_episodes_beside_branches_the_controller_alone_is_perturbed(beside, whole):
    assert {task.signs for task in whole.work.tasks} == {((1, 0), (-1, 0))}
    assert whole.learns == (True, False)
    assert {len(task.snapshot_steps) for task in whole.work.tasks} == {2}
    assert whole.work.generation.snapshot_goals == 2


def test_without_a_perturbation_both_sides_end_in_the_same_bits(beside, alone, whole):
    """Their seeds, starts and goals are the same: what differs otherwise is the perturbation alone."""
    for case, left in ((beside, list(whole.results.snapshots.values())), (alone, None)):
        work = branch_work(case.state, case.settings.intervals, case.table.size, left)
        generation = replace(work.generation, sigma=0.0)
        case.backend.broadcast(generation)
        results = PopulationResults.of_tasks(work.tasks, generation)
        for task, result in zip(work.tasks, case.backend.map(work.tasks), strict=True):
            results.add(task, result)
        for values in (results.returns[0], results.environment_returns, results.steps, results.has_fallen):
            assert values[0::2].tobytes() == values[1::2].tobytes()
        assert results.final_position[0::2].tobytes() == results.final_position[1::2].tobytes()
        for task in work.tasks:
            ends = case.play(task, generation).ends
            assert ends[0].tobytes() == ends[1].tobytes()
        assert len(np.unique(results.returns[0])) == len(work.tasks)


def test_branches_on_drawn_goals_where_nothing_was_left(beside, whole):
    nothing = replace(whole, results=replace(whole.results, snapshots={}))
    branches = roll_out_branches(beside.state, beside.settings, beside.table, beside.backend, nothing)
    played = beside.check(branches)
    for task in branches.work.tasks:
        assert task.start.state is None
        assert played[task.member].goals[0] == pytest.approx(np.tile(task.start.goals[0], (2, 1)), abs=1e-12)


def test_running_episodes_go_on_where_the_kept_side_ended(alone):
    """Three generations: some fall, some go on, all begin anew when their time is over."""
    state, seen = alone.state, set()
    for number, report in zip(range(4), evolve(state, alone.settings, alone.table, alone.backend), strict=False):
        work, running = report.population.work, report.state.running
        played = alone.check(report.population)
        assert report.branches is None
        for group, task in enumerate(work.tasks):
            before = 0 if task.start is None else task.start.steps
            run, kept = played[task.member], task.kept_slot
            goes_on = not run.fell[kept] and before + 10 < HORIZON
            seen.add((before, bool(run.fell[kept]), goes_on))
            steps = -1 if running is None else running.steps[group]
            assert steps == (before + 10 if goes_on else -1)
            if goes_on:
                assert running.states[group].tobytes() == run.ends[kept].tobytes()
        assert [task.start is None for task in work.tasks] == [
            state.running is None or steps < 0
            for steps in (np.zeros(8) if state.running is None else state.running.steps)
        ]
        state = report.state
        assert state.generation == number + 1
    assert {(0, False, True), (10, False, True), (20, False, False), (0, True, False)} <= seen


def test_a_primitive_alone_has_branches_and_no_whole_episodes(alone):
    work = generation_work(alone.state, alone.settings, alone.table.size)
    assert work.generation.branch_steps == 10
    assert len(work.tasks) == 8
    population = roll_out(alone.state, alone.settings, alone.table, alone.backend)
    assert population.is_branched
    assert roll_out_branches(alone.state, alone.settings, alone.table, alone.backend, population) is None


def test_the_primitive_beside_a_controller_learns_from_the_pairs_alone(beside, whole):
    (report,) = [next(evolve(beside.state, beside.settings, beside.table, beside.backend))]
    branches = report.branches
    (update,) = branches.update(beside.state.levels[-1:], beside.table, None)
    assert report.state.levels[-1].theta.tobytes() == update.level.theta.tobytes()
    assert report.state.levels[-1].theta.tobytes() != beside.state.levels[-1].theta.tobytes()
    assert report.state.levels[-1].statistics.count == branches.num_steps
    assert report.state.levels[0].statistics.count == -(-whole.results.steps // STEPS).sum()
    assert report.state.env_steps == report.num_steps == whole.num_steps + branches.num_steps
    assert report.state.running is None
    assert report.sources[1][0] is branches
