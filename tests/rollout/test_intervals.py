"""Primitives that are evaluated by intervals: their pairs, where these begin, what goes on, and what counts."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.es.level import draw_noise_index, update_level
from shes.evolution.algorithm import evolve, roll_out
from shes.evolution.estimates import IntervalEstimate, draw_episodes, draw_pairs, next_running
from shes.evolution.state import RunningEpisodes
from shes.rollout.episodes import Snapshot
from shes.rollout.roll_out import PopulationResults
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.rollout.formula import SETTINGS, bits, changing, constant, formula_state, shaped_fitness, start_state
from tests.rollout.plain_loop import play

PAIRS = 6
STEPS = 5
"""Control steps of an interval."""
HORIZON = 23
"""Control steps of an episode: the last interval is cut short."""
ESTIMATE = IntervalEstimate(population_size=2 * PAIRS, intervals=2, controller_interval=STEPS, goal_distance=4.0,
                            sigma=changing(0.2, 0.1, 2), learning_rate=constant(0.03))  # fmt: skip
BESIDE = replace(SETTINGS, intervals=ESTIMATE, horizon=HORIZON)
ALONE = replace(BESIDE, updates=SETTINGS.updates[:1], learns=(True,))


def alone_state(running=None, **changes):
    """Return the state of a primitive alone."""
    state = start_state([np.arange(7, dtype=np.float32)], (3,), settings=ALONE, names=("primitive",))
    return replace(state, running=running, **changes)


def snapshot(number, size=4):
    return Snapshot(state=np.full(size, float(number)), steps=STEPS * number, goals=np.full((2, 2), number / 10))


def pairs_after(left, generation=0, **changes):
    """Return pairs that follow whole episodes with the snapshots `left`; None for a primitive alone."""
    if left is None:
        return draw_pairs(alone_state(generation=generation, **changes), ALONE, 1000)
    before = SimpleNamespace(results=SimpleNamespace(snapshots=dict(enumerate(left))))
    return draw_pairs(replace(formula_state(), generation=generation, **changes), BESIDE, 1000, (before,))


# What is drawn --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [None, 0, 1, 2, 4, 6, 40])
def test_pairs_are_drawn_from_a_stream_of_their_own(number):
    """Snapshots are used evenly; without any, goals are drawn. All pairs of one task share noise, seed and start."""
    left, generation = None if number is None else [snapshot(n) for n in range(number)], 2
    draws, state = pairs_after(left, generation), alone_state() if left is None else formula_state()
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(3, spawn_key=(8, generation))))
    seeds, kept = rng.integers(0, 2**63, PAIRS).tolist(), rng.integers(0, 2, PAIRS).tolist()
    starts = [None] * PAIRS
    if left:
        order = rng.permutation(number)
        starts = [left[order[group % number]] for group in range(PAIRS)]
    elif left is not None:
        starts = [Snapshot(state=None, steps=0, goals=goals) for goals in rng.uniform(-4, 4, (PAIRS, 2, 2))]
    # The primitive's noise is that of its level: neither level's says anything of the other's.
    noise = draw_noise_index(3, generation, PAIRS, [len(level.theta) for level in state.levels], 1000)[-1]
    assert draws.noise_index.tolist() == [noise.tolist()]
    assert draws.signs.tolist() == [[[1], [-1]]] * PAIRS
    for group, task in enumerate(draws.tasks):
        assert (task.member, task.signs, task.slots) == (2 * group, ((1,), (-1,)), (0, 1))
        assert (task.noise_index, task.seeds) == ((noise[group],), (seeds[group],) * 2)
        assert bits(task.start) == bits(starts[group])
        assert task.kept_slot == (kept[group] if left is None else None)
        assert (task.records_statistics, task.snapshot_steps) == (True, ())
    generation = draws.generation
    assert generation.sigma == pytest.approx(0.1)  # the schedule's in the third generation
    assert (generation.members_per_lane, generation.episodes_per_policy, generation.rows_per_lane) == (2, 1, 2)
    assert (generation.branch_steps, generation.kind) == (2 * STEPS, "branch")
    assert [level.theta.tobytes() for level in generation.levels] == [state.levels[-1].theta.tobytes()]
    assert draws.levels == (len(state.levels) - 1,)


def test_pairs_begin_where_the_running_episodes_are():
    states, steps = np.random.default_rng(0).normal(size=(PAIRS, 4)), np.array([10, -1, 20, 10, -1, 10])
    draws = draw_pairs(alone_state(RunningEpisodes(states=states, steps=steps)), ALONE, 1000)
    for group, task in enumerate(draws.tasks):
        expected = None if steps[group] < 0 else Snapshot(state=states[group], steps=int(steps[group]))
        assert bits(task.start) == bits(expected)  # without goals: the environment sets them


@pytest.mark.parametrize(("horizon", "decisions"), [(23, 5), (25, 5), (26, 6), (3, 1)])
def test_whole_episodes_leave_snapshots_at_any_decision(horizon, decisions):
    settings = replace(BESIDE, population_size=400, horizon=horizon, episodes_per_policy=1)
    draws = draw_episodes(replace(formula_state(), generation=2), settings, 1000)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(3, spawn_key=(7, 2))))
    steps = [steps for task in draws.tasks for steps in task.snapshot_steps]
    assert steps == (STEPS * rng.integers(0, decisions, 400)).tolist()
    assert set(steps) == {STEPS * number for number in range(decisions)}
    assert draws.generation.snapshot_goals == 2
    # The primitive, which pairs evaluate, has no noise here: it would be noise in the controller's fitness.
    assert draws.generation.has_frozen_control
    assert {task.signs for task in draws.tasks} == {((1, 0), (-1, 0))}


# What goes on --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ends", "steps"),
    [
        ({0: 5, 5: 10, 10: 15}, [5, -1, 10, -1, -1, 15]),
        ({2: HORIZON - 1, 4: 5}, [-1, HORIZON - 1, 5, -1, -1, -1]),
        ({2: HORIZON, 4: 5}, [-1, -1, 5, -1, -1, -1]),  # an episode begins anew at its horizon
        ({3: HORIZON + 4}, None),
        ({}, None),
    ],
)
def test_an_episode_goes_on_from_the_side_that_was_kept(ends, steps):
    results = PopulationResults.empty(1, 2 * PAIRS, 1)
    results.snapshots.update({(m, 0): replace(snapshot(1 + m), steps=after) for m, after in ends.items()})
    running = next_running(SimpleNamespace(results=results, signs=np.ones((PAIRS, 2, 1))), HORIZON)
    if steps is None:
        assert running is None
        return
    assert running.steps.tolist() == steps
    states = {m // 2: [1.0 + m] * 4 for m, after in ends.items() if after < HORIZON}
    assert running.states.tolist() == [states.get(group, [0] * 4) for group in range(PAIRS)]


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
    "rank_ties": "index",
    "chunk_size": 4,  # lanes are used again, out of step with each other
}
UNDER_CONTROLLER = {"intervals": 3, "primitive_population_size": 12, "primitive_sigma": 0.2,
                    "primitive_learning_rate": 0.07}  # fmt: skip


class Case:
    """A run on the ant, with what its generations are made of."""

    def __init__(self, env, settings):
        config = make_config(env, "smoke", {**ANT, **settings})
        learner = build_algorithm(config)
        self.settings, self.table, self.state = learner.hyperparameters, learner.table, learner.start(config.run.seed)
        self.plan = learner.plan()
        self.backend = SerialBackend(partial(RolloutWorker, self.plan))

    def play(self, task, generation):
        """Play the episodes of `task` by a plain loop."""
        design = self.plan.branch_design if generation.branch_steps and self.plan.branch_design else self.plan.design
        make, horizon = partial(self.plan.env.make, options=self.plan.training), generation.branch_steps or HORIZON
        return play(design, make, task, generation, self.table, horizon)

    def draw(self, before=()):
        return (draw_pairs if before else self.settings.estimates[0])(
            self.state, self.settings, self.table.size, before
        )

    def check(self, population):
        """Compare each task's outcomes with the plain loop; return what that saw, by the task's first member."""
        found = {task.member: self.play(task, population.generation) for task in population.tasks}
        outcomes = population.results.outcomes[:, 0]
        for member, played in found.items():
            for k, own in enumerate(played.found):
                mine = {name: outcomes[member + k][name].tolist() for name in outcomes.dtype.names}
                assert mine == {name: own[name] for name in mine}
        counts = [[own["moments"][level][0] for played in found.values() for own in played.found]
                  for level in range(len(population.levels))]  # fmt: skip
        assert [int(m.count[0]) for m in population.results.moments] == [sum(each) for each in counts]
        return found


@pytest.fixture(scope="module")
def beside():
    """A controller, with a primitive that pairs on branches evaluate."""
    case = Case("ant-gather", UNDER_CONTROLLER)
    with case.backend:
        yield case


@pytest.fixture(scope="module")
def alone():
    """A primitive whose episodes run from generation to generation."""
    case = Case("ant-flagrun", {})
    with case.backend:
        yield case


@pytest.fixture(scope="module")
def whole(beside):
    """The whole episodes of the first generation."""
    return roll_out(beside.draw(), beside.backend)


def test_a_snapshot_is_the_state_at_its_decision_with_its_goals(beside, whole):
    """Its goal and the next two; the last one again after the end of the episode."""
    played, snapshots, seen = beside.check(whole), whole.results.snapshots, []
    for task in whole.tasks:
        for slot, wanted in zip(task.slots, task.snapshot_steps, strict=True):
            run, steps = played[task.member], played[task.member].found[slot]["steps"]
            assert ((task.member + slot, 0) in snapshots) == (steps > wanted)
            if steps > wanted:
                left, decisions = snapshots[task.member + slot, 0], range(wanted, min(steps, wanted + 15), STEPS)
                goals = [run.goals[decision][slot] for decision in decisions]
                assert (left.steps, left.state.tobytes()) == (wanted, run.states[wanted][slot].tobytes())
                assert left.goals.tobytes() == np.array(goals + goals[-1:] * (3 - len(goals))).tobytes()
                seen.append((len(goals), run.found[slot]["has_fallen"]))
            else:
                seen.append((0, True))
    assert {(0, True), (1, False), (2, False), (3, False)} <= set(seen)
    assert any(number and fell for number, fell in seen)
    assert {left.steps for left in snapshots.values()} >= {0, 20}  # a start itself, and a last decision


def test_a_branch_is_what_a_plain_loop_makes_of_its_start(beside, whole):
    """From snapshots; or, where no episode left any, from a reset on goals that are drawn."""
    nothing = replace(whole, results=replace(whole.results, snapshots={}))
    for before in (whole, nothing):
        pairs = roll_out(beside.draw((before,)), beside.backend)
        left, played = {id(each) for each in before.results.snapshots.values()}, beside.check(pairs)
        for task in pairs.tasks:
            run = played[task.member]
            assert id(task.start) in left or (not left and task.start.state is None)
            if left:
                assert run.states[0].tobytes() == np.tile(task.start.state, (2, 1)).tobytes()
            for number, goal in enumerate(task.start.goals):
                for row in range(2):
                    if run.found[row]["steps"] > number * STEPS:
                        assert run.goals[number * STEPS][row] == pytest.approx(goal, abs=1e-12)
        assert pairs.results.snapshots == {}
        assert np.ptp(pairs.results.returns[0].reshape(-1, 2), axis=1).all()  # the two sides differ


def test_without_a_perturbation_both_sides_end_in_the_same_bits(beside, alone, whole):
    """Their seeds, starts and goals are the same: what differs otherwise is the perturbation alone."""
    for case, before in ((beside, (whole,)), (alone, ())):
        draws = case.draw(before)
        still = replace(draws, generation=replace(draws.generation, sigma=0.0))
        outcomes = roll_out(still, case.backend).results.outcomes
        assert np.array_equal(outcomes[0::2], outcomes[1::2])
        for task in draws.tasks:
            first, second = case.play(task, still.generation).ends
            assert first.tobytes() == second.tobytes()
        assert len(np.unique(outcomes["returns"])) == len(draws.tasks)


def test_running_episodes_go_on_where_the_kept_side_ended(alone):
    """Four generations: some fall, some go on, all begin anew when their time is over."""
    state, seen = alone.state, set()
    for _, report in zip(range(4), evolve(state, alone.settings, alone.table, alone.backend), strict=False):
        (pairs,), running = report.populations, report.state.running
        played = alone.check(pairs)
        for group, task in enumerate(pairs.tasks):
            before, kept = 0 if task.start is None else task.start.steps, task.kept_slot
            run, has_fallen = played[task.member], played[task.member].found[kept]["has_fallen"]
            goes_on = not has_fallen and before + 10 < HORIZON
            seen.add((before, has_fallen, goes_on))
            assert (-1 if running is None else running.steps[group]) == (before + 10 if goes_on else -1)
            assert not goes_on or running.states[group].tobytes() == run.ends[kept].tobytes()
        old = [-1] * 8 if state.running is None else state.running.steps.tolist()
        assert [task.start is None for task in pairs.tasks] == [steps < 0 for steps in old]
        state = report.state
    assert {(0, False, True), (10, False, True), (20, False, False), (0, True, False)} <= seen


def test_under_a_controller_pairs_alone_teach_the_primitive(beside, whole):
    report = next(evolve(beside.state, beside.settings, beside.table, beside.backend))
    first, pairs = report.populations
    assert bits(first) == bits(whole)
    assert (first.generation.sigma, first.learning_rate) == (0.3, 0.01)
    assert (pairs.generation.sigma, pairs.learning_rate) == (0.2, 0.07)
    for i, (level, source) in enumerate(zip(report.state.levels, (first, pairs), strict=True)):
        rule, before = beside.settings.updates[i], beside.state.levels[i]
        shaped, signs = shaped_fitness(source, 0, rule), source.signs[:, :, 0]
        update = update_level(before, shaped, signs, source.noise_index[0], beside.table, rule, source.learning_rate)
        assert level.theta.tobytes() == update.level.theta.tobytes() != before.theta.tobytes()
    controller, primitive = (level.statistics.count for level in report.state.levels)
    assert (controller, primitive) == (-(-first.results.steps // STEPS).sum(), pairs.results.steps.sum())
    assert report.state.env_steps == first.results.steps.sum() + pairs.results.steps.sum()
    assert report.state.running is None
    assert report.sources == ((first, 0), (pairs, 0))
