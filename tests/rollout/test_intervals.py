"""Primitives that are evaluated by intervals: their pairs, where these begin, what goes on, and what counts."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.es.level import draw_noise_index
from shes.evolution.algorithm import evolve, roll_out
from shes.evolution.estimates import EvolutionSettings, IntervalEstimate, draw_episodes, draw_pairs
from shes.rollout.episodes import Snapshot, wander
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from shes.streams import Purpose, stream
from tests.rollout.formula import SETTINGS, bits, evolving, formula_state
from tests.rollout.plain_loop import play

PAIRS, STEPS = 6, 5
"""Number of pairs, and control steps of an interval."""
HORIZON = 23
"""Control steps of an episode: the last interval is cut short."""
FALLING = {"sigma": 0.2, "sigma_end": 0.1, "learning_rate": 0.2, "learning_rate_end": 0.1, "schedule_generations": 2}
PAIRED = EvolutionSettings(population_size=2 * PAIRS, **FALLING)
ESTIMATE = IntervalEstimate(evolution=PAIRED, intervals=2, controller_interval=STEPS, goal_distance=4.0)
BESIDE = replace(SETTINGS, intervals=ESTIMATE, horizon=HORIZON)
ALONE = replace(BESIDE, updates=SETTINGS.updates[:1], learns=(True,))


@pytest.mark.parametrize(
    ("number", "way_steps", "practice", "going"),
    [(None, None, 0, 6), (0, None, 0, 6), (4, None, 0, 0), (40, None, 2, 0), (40, None, 3, 6),
     (4, 0, 0, 6), (4, 300, 2, 3), (40, 300, 0, 4), (5, 300, 0, 6), (0, 300, 0, 6), (4, 300, 3, 6)],
)  # fmt: skip
def test_pairs_are_drawn_from_a_stream_of_their_own(number, way_steps, practice, going):
    """Snapshots are used evenly; practice and a search run on, also on the way. Pairs share noise, seed and start."""
    left, before, state, generation = [], (), formula_state(), 2
    settings = replace(BESIDE, practice=practice)
    ends = [Snapshot(state=np.full(4, -1.0), steps=10), None] * 3
    if number is None:
        state, settings = replace(state, levels=state.levels[1:]), ALONE
    else:
        left = [Snapshot(state=np.full(4, float(n)), steps=STEPS * n, goals=np.ones((2, 2))) for n in range(number)]
        success = {40: [1, 0, 0], 5: [0, 0, 0]}.get(number, [1, 0, 1])  # of the whole episodes: the snapshots' share
        shown = {"snapshots": {0: left[:1], 1: left[1:]}, "outcomes": {"success": np.array(success, np.bool_)}}
        before = (SimpleNamespace(results=SimpleNamespace(**shown)),)
    known = np.arange(8.0).reshape(2, 4)[: way_steps or 0]
    archive = None if way_steps is None else SimpleNamespace(way_steps=way_steps, starts=known)
    state = replace(state, generation=generation, archive=archive, running=tuple(ends))
    draws = draw_pairs(state, settings, 1000, before)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(3, spawn_key=(8, generation))))
    seeds, kept = rng.integers(0, 2**63, PAIRS).tolist(), rng.integers(0, 2, PAIRS).tolist()
    starts = ends[:going]
    if before:
        goes_on = rng.random(going) >= 0.3
        goals = [[(4 * np.cos(angle), 4 * np.sin(angle)) for angle in own] for own in wander(rng, 2, going).T]
        places = [None] * going
        if way_steps:
            is_on_way, chosen = rng.random(going) < 0.5, rng.integers(0, 2, going)
            places = [known[i] if on_way else None for i, on_way in zip(chosen, is_on_way, strict=True)]
        begun = [Snapshot(state=place, steps=0) for place in places]
        begun = [end if goes_on[i] and end else begun[i] for i, end in enumerate(starts)]
        starts = [replace(end, goals=np.array(own)) for end, own in zip(begun, goals, strict=True)]
        order = rng.permutation(number)
        starts += [left[order[group % number]] for group in range(PAIRS - going)]
    # The primitive's noise is that of its level: neither level's says anything of the other's.
    noise = draw_noise_index(3, generation, PAIRS, [len(level.theta) for level in state.levels], 1000)[-1]
    assert draws.noise_index.tolist() == [noise.tolist()]
    assert draws.signs.tolist() == [[[1], [-1]]] * PAIRS
    for group, task in enumerate(draws.tasks):
        assert (task.member, task.signs, task.slots) == (2 * group, ((1,), (-1,)), (0, 1))
        assert (task.noise_index, task.seeds) == ((noise[group],), (seeds[group],) * 2)
        assert bits(task.start) == bits(starts[group])
        assert task.kept_slot == (kept[group] if group < going else None)
        assert (task.records_statistics, task.snapshot_steps) == (True, ())
    generation, rate = draws.generation, {0: 0.1, 2: 0.2, 3: 0.2}[practice]  # schedules follow practice
    assert (generation.sigma, draws.learning_rate) == pytest.approx((rate, rate))
    assert (generation.members_per_lane, generation.episodes_per_policy, generation.rows_per_lane) == (2, 1, 2)
    assert (generation.branch_steps, generation.kind) == (2 * STEPS, "branch")
    assert [level.theta.tobytes() for level in generation.levels] == [state.levels[-1].theta.tobytes()]
    assert draws.levels == (len(state.levels) - 1,)


@pytest.mark.parametrize(("horizon", "decisions"), [(23, 5), (25, 5), (26, 6), (3, 1)])
def test_whole_episodes_leave_snapshots_at_any_decision(horizon, decisions):
    many = replace(ESTIMATE, evolution=replace(PAIRED, population_size=200))  # so that each pair has a start of its own
    settings = replace(evolving(BESIDE, population_size=40, episodes_per_policy=1), horizon=horizon, intervals=many)
    draws = draw_episodes(replace(formula_state(), generation=2), settings, 1000)
    rng, every = stream(3, Purpose.SNAPSHOTS, 2), np.tile(np.arange(decisions), (40, 1))
    steps = [steps for task in draws.tasks for steps in task.snapshot_steps]
    assert steps == [*map(tuple, STEPS * rng.permuted(every, axis=1)[:, :3])]
    assert draws.generation.snapshot_goals == 2
    # The primitive, which pairs evaluate, has no noise here: it would be noise in the controller's fitness.
    assert draws.generation.has_frozen_control
    assert {task.signs for task in draws.tasks} == {((1, 0), (-1, 0))}


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
UNDER_CONTROLLER = {"intervals": 3, "primitive_population_size": 40, "primitive_sigma": 0.2,
                    "primitive_learning_rate": 0.07, "fitness_shaping": "centred_rank_index"}  # fmt: skip


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
        draw = draw_pairs if before else self.settings.estimates[0]
        return draw(self.state, self.settings, self.table.size, before)

    def check(self, population):
        """Compare each task's outcomes with the plain loop; return what that saw, by the task's first member."""
        found = {task.member: self.play(task, population.generation) for task in population.tasks}
        for member, played in found.items():
            mine = population.results.outcomes[member : member + len(played.outcomes), 0]
            assert np.array_equal(mine, played.outcomes)
        for level, statistics in enumerate(population.results.statistics):
            assert statistics.count == sum(np.array(played.moments[level])[:, 0].sum() for played in found.values())
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
    case = Case("ant-flagrun", {"horizon": 30})  # three intervals
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
        run = played[task.member]
        for slot, every in zip(task.slots, task.snapshot_steps, strict=True):
            steps = run.outcomes[slot]["steps"]
            found = {left.steps: left for left in snapshots.get((task.member + slot, 0), ())}
            assert list(found) == [wanted for wanted in every if steps > wanted]
            for wanted, left in found.items():
                goals = [run.goals[each][slot] for each in range(wanted, min(steps, wanted + 15), STEPS)]
                assert left.state.tobytes() == run.states[wanted][slot].tobytes()
                assert left.goals.tobytes() == np.array(goals + goals[-1:] * (3 - len(goals))).tobytes()
                seen.append((len(goals), run.outcomes[slot]["has_terminated"]))
    assert {(1, False), (2, False), (3, False)} < set(seen)  # and one that fell
    assert {left.steps for own in snapshots.values() for left in own} >= {0, 20}  # a start itself, and a last decision


def test_a_branch_is_what_a_plain_loop_makes_of_its_start(beside, whole):
    """From snapshots; or, where no episode left any, from a reset on goals that wander."""
    nothing = replace(whole, results=replace(whole.results, snapshots={}))
    for before in (whole, nothing):
        pairs = roll_out(beside.draw((before,)), beside.backend)
        left, played = {id(each) for own in before.results.snapshots.values() for each in own}, beside.check(pairs)
        for task in pairs.tasks:
            run = played[task.member]
            assert id(task.start) in left or (not left and task.start.state is None)
            if left:
                assert run.states[0].tobytes() == np.tile(task.start.state, (2, 1)).tobytes()
            for number, goal in enumerate(task.start.goals):
                for row in range(2):
                    if run.outcomes[row]["steps"] > number * STEPS:
                        assert run.goals[number * STEPS][row] == pytest.approx(goal, abs=1e-12)
        assert bool(pairs.results.snapshots) is not bool(left)
        assert np.ptp(pairs.results.returns[0].reshape(-1, 2), axis=1).all()  # the two sides differ


def test_running_episodes_go_on_where_the_kept_side_ended(alone):
    """Four generations: some fall, some go on, all begin anew when their time is over."""
    state, seen = alone.state, set()
    for _, report in zip(range(4), evolve(state, alone.settings, alone.table, alone.backend), strict=False):
        (pairs,), running = report.populations, report.state.running
        played = alone.check(pairs)
        for group, task in enumerate(pairs.tasks):
            before, kept = 0 if task.start is None else task.start.steps, task.kept_slot
            run, has_fallen = played[task.member], played[task.member].outcomes[kept]["has_terminated"]
            goes_on = not has_fallen and before + 10 < 30
            seen.add((before, has_fallen, goes_on))
            end = running and running[group]
            assert bits(end) == bits(Snapshot(state=run.ends[kept], steps=before + 10) if goes_on else None)
            assert task.start is (state.running and state.running[group])
        state = report.state
    assert {(0, False, True), (10, False, True), (20, False, False), (0, True, False)} <= seen
