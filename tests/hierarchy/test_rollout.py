"""The roll-out on a task without physics: no result depends on lanes, order or company; episodes end as they should."""

import math
import random
from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest

from shes.errors import PolicyError
from shes.es.level import LevelParameters
from shes.es.noise import NoiseTable
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.clock import Clock
from shes.hierarchy.episodes import PARTS, EpisodeTask, Generation
from shes.hierarchy.exploration import EXPLORATION_STD
from shes.hierarchy.flat import FlatDesign
from shes.hierarchy.goals import AngleEncoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.outputs import VectorOutput
from shes.hierarchy.primitive import PrimitiveDesign
from shes.hierarchy.rewards import ProgressReward
from shes.hierarchy.rollout import Rollout
from shes.policies.mlp import MLP
from shes.types import CONTROLLER, PRIMITIVE
from tests.hierarchy.fake_task import FakeEnvironment, FakeTask, Script, make_seed

INTERVAL = 5
HORIZON = 23
EPISODES = 3
SIGMA = 0.2

DESIGN = HierarchicalDesign(
    controller=MLP(5, (16,), 2),
    primitive=MLP(8, (16,), 2),
    goal_encoding=AngleEncoding(),
    primitive_reward=ProgressReward(),
    controller_output=VectorOutput(),
    goal_distance=4.0,
    controller_interval=INTERVAL,
    has_minimum_goal_distance=True,
    control_limit=1.0,
)

ALONE = {
    "primitive": (
        PrimitiveDesign(
            primitive=MLP(8, (16,), 2),
            goal_encoding=AngleEncoding(),
            primitive_reward=ProgressReward(),
            controller_interval=INTERVAL,
            control_limit=1.0,
        ),
        FakeEnvironment(goal_interval=INTERVAL),
    ),
    "primitive with a clock": (
        PrimitiveDesign(
            primitive=MLP(10, (16,), 2),
            goal_encoding=AngleEncoding(),
            primitive_reward=ProgressReward(),
            controller_interval=INTERVAL,
            control_limit=1.0,
            clock=Clock(frequency_hz=1.5, step_s=0.1),
        ),
        FakeEnvironment(goal_interval=INTERVAL),
    ),
    "flat": (FlatDesign(policy=MLP(5, (16,), 2), control_limit=1.0), FakeEnvironment()),
    "flat with a clock": (
        FlatDesign(policy=MLP(7, (16,), 2), control_limit=1.0, clock=Clock(frequency_hz=1.5, step_s=0.1)),
        FakeEnvironment(),
    ),
}
"""Agents of one level, each with what makes its episodes."""


def _table(size=2000):
    return NoiseTable(np.random.default_rng(0).standard_normal(size, dtype=np.float32))


def _generation(design=DESIGN, *, scale=1.0, sigma=SIGMA, is_evaluation=False):
    rng = np.random.default_rng(1)
    levels = []
    for mlp in design.policies:
        statistics = ObservationStatistics.empty(mlp.sizes[0]).merge(
            4, rng.normal(size=mlp.sizes[0]), rng.uniform(4, 9, mlp.sizes[0])
        )
        theta = mlp.initial(rng, "glorot_normal") * np.float32(scale)
        levels.append(LevelParameters.of(theta, statistics))
    return Generation(levels=tuple(levels), sigma=sigma, episodes_per_policy=EPISODES, is_evaluation=is_evaluation)


def _task(member, seeds, *, slots=None, signs=(1, -1), records=True):
    return EpisodeTask(
        member=member,
        noise_index=(7 * member, 100 + 11 * member),
        signs=(signs,),
        slots=tuple(range(len(seeds))) if slots is None else tuple(slots),
        seeds=tuple(seeds),
        records_statistics=records,
    )


def _rollout(lanes=1, *, design=DESIGN, episodes=EPISODES, horizon=HORIZON, on_step=None):
    return Rollout(design, lambda n: FakeTask(n, on_step), lanes, episodes, horizon)


def _run(rollout, tasks, generation=None, table=None):
    """Return the results by member, each of which comes once."""
    done = list(rollout.run(iter(enumerate(tasks)), generation or _generation(), table or _table()))
    assert sorted(number for number, _ in done) == list(range(len(tasks)))
    return {tasks[number].member: results for number, results in done}


def _run_in_order(rollout, tasks):
    results = _run(rollout, tasks)
    return [results[task.member] for task in tasks]


def _bits(results):
    """Return everything in `results` [K episodes] as bytes, episode by episode."""
    moments = [a for m in results.moments or () for a in (m.count, m.total, m.total_squares)]
    arrays = [
        *results.returns,
        results.score,
        results.success,
        results.steps,
        results.has_terminated,
        results.has_fallen,
    ]
    arrays += [results.has_diverged, results.goals_reached, results.final_position, results.environment_returns]
    arrays += moments
    return [b"".join(a[k].tobytes() for a in arrays) for k in range(len(results.steps))]


@pytest.fixture(scope="module")
def population():
    rng = random.Random(0)  # noqa: S311 - seeds of a test
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, 0)]
    return [
        _task(member, [rng.randrange(2**63) for _ in range(EPISODES)], signs=signs[member % 6], records=member % 5 != 0)
        for member in range(14)
    ]


@pytest.fixture(scope="module")
def alone(population):
    """Results of every member in a roll-out of its own."""
    return {task.member: _bits(_run(_rollout(1), [task])[task.member]) for task in population}


def test_the_population_has_episodes_of_every_kind(population, alone):
    scripts = [Script.of(seed) for task in population for seed in task.seeds]
    ended = [(bool(s.terminates_after), bool(s.diverges_after), s.steps(HORIZON) == HORIZON) for s in scripts]
    assert {(False, False, True), (True, False, False), (False, True, False), (True, True, False)} <= set(ended)
    assert len({bits for member in alone.values() for bits in member}) == len(scripts)


@pytest.mark.parametrize("lanes", [1, 2, 3, 5, 14, 20])
def test_results_do_not_depend_on_the_number_of_lanes(population, alone, lanes):
    results = _run(_rollout(lanes), population)
    assert {member: _bits(r) for member, r in results.items()} == alone


@pytest.mark.parametrize("seed", range(3))
def test_results_do_not_depend_on_the_order_of_tasks_nor_on_who_else_runs(population, alone, seed):
    tasks = random.Random(seed).sample(population, 9)  # noqa: S311 - the order of a test
    for member, results in _run(_rollout(4), tasks).items():
        assert _bits(results) == alone[member]


def test_results_do_not_depend_on_what_the_rollout_did_before(population, alone):
    rollout = _rollout(3)
    _run(rollout, population[7:], _generation(scale=3, is_evaluation=True))
    for _ in range(2):
        assert {m: _bits(r) for m, r in _run(rollout, population[:5]).items()} == {m: alone[m] for m in range(5)}


@pytest.mark.parametrize("slots", [(0,), (1,), (2,), (2, 0), (1, 2)])
def test_an_episode_alone_is_the_same_as_among_the_others_of_its_policy(population, alone, slots):
    tasks = [
        _task(t.member, [t.seeds[s] for s in slots], slots=slots, signs=t.signs[0], records=t.records_statistics)
        for t in population
    ]
    for member, results in _run(_rollout(4), tasks).items():
        assert _bits(results) == [alone[member][s] for s in slots]


@pytest.mark.parametrize("lanes", [1, 2, 6])
def test_with_one_episode_a_policy_results_do_not_depend_on_lanes(population, lanes):
    # E = 1: matrix times vector, another path through BLAS; one lane of it is a batch of one row.
    tasks = [_task(t.member, t.seeds[:1], signs=t.signs[0]) for t in population]
    expected = {t.member: _bits(_run(_rollout(3, episodes=1), [t])[t.member]) for t in tasks}
    assert {m: _bits(r) for m, r in _run(_rollout(lanes, episodes=1), tasks).items()} == expected


def test_results_come_with_their_numbers_as_soon_as_they_are_there():
    long, short = make_seed(), make_seed(terminates_after=2)
    tasks = [_task(0, [long]), _task(1, [short]), _task(2, [short]), _task(3, [short])]
    work = ((10 * number, task) for number, task in enumerate(tasks))
    done = [number for number, _ in _rollout(2, episodes=1).run(work, _generation(), _table())]
    assert done == [10, 20, 30, 0]


def test_tasks_are_taken_only_when_a_lane_is_free():
    taken = []

    def work():
        for number in range(5):
            taken.append(number)
            yield number, _task(number, [make_seed(terminates_after=3)] * EPISODES)

    counts = []
    for _ in _rollout(2).run(work(), _generation(), _table()):
        counts.append(len(taken))
    assert counts == [2, 2, 4, 4, 5]


def test_without_work_there_are_no_results():
    assert _run(_rollout(3), []) == {}


@pytest.mark.parametrize("lanes", [1, 3])
def test_statistics_count_every_step_of_the_primitive_and_every_decision_of_the_controller(population, lanes):
    tasks = [_task(t.member, t.seeds) for t in population]
    for task, results in zip(tasks, _run_in_order(_rollout(lanes), tasks), strict=True):
        expected = [Script.of(seed).steps(HORIZON) for seed in task.seeds]
        assert results.steps.tolist() == expected
        assert results.moments[PRIMITIVE].count.tolist() == expected
        assert results.moments[CONTROLLER].count.tolist() == [math.ceil(steps / INTERVAL) for steps in expected]


def test_moments_are_sums_of_what_was_observed():
    seen = []
    rollout = _rollout(1, on_step=lambda task, *_: seen.append(task.observe()[0]))
    results = _run(rollout, [_task(0, [make_seed(terminates_after=steps) for steps in (12, 1, 2)])])
    seen = np.array(seen)
    assert len(seen) == 12
    moments = results[0].moments
    assert moments[CONTROLLER].total[0] == pytest.approx(seen[::INTERVAL].sum(axis=0))
    assert moments[CONTROLLER].total_squares[0] == pytest.approx((seen[::INTERVAL] ** 2).sum(axis=0))
    assert moments[PRIMITIVE].total[0, 3:] == pytest.approx(seen.sum(axis=0))
    assert moments[PRIMITIVE].total_squares[0, :2].sum() == pytest.approx(12)  # sin and cos


def test_statistics_come_only_when_asked_for():
    tasks = [_task(0, [1, 2, 3], records=False), _task(1, [1, 2, 3])]
    results = _run(_rollout(2), tasks)
    assert results[0].moments is None
    assert results[1].moments is not None


def test_an_episode_ends_by_its_own_rule_or_at_the_horizon():
    seeds = [make_seed(terminates_after=4), make_seed(), make_seed(diverges_after=6)]
    results = _run(_rollout(), [_task(0, seeds)])[0]
    assert results.steps.tolist() == [4, HORIZON, 6]
    assert results.has_terminated.tolist() == [True, False, False]
    assert not results.has_fallen.any()
    assert results.has_diverged.tolist() == [False, False, True]


def test_an_episode_that_terminates_at_the_horizon_has_terminated():
    results = _run(_rollout(horizon=4, episodes=2), [_task(0, [make_seed(terminates_after=4), make_seed()])])[0]
    assert results.steps.tolist() == [4, 4]
    assert results.has_terminated.tolist() == [True, False]


def test_a_divergence_is_counted_pays_nothing_for_its_step_and_scores_nothing():
    before = []  # the return before each step

    def on_step(task, ids, action):
        del ids, action
        before.append(float(task.running_return[0]))

    rollout = _rollout(episodes=1, on_step=on_step)
    results = _run(rollout, [_task(0, [make_seed(diverges_after=6, draw=9)])])[0]
    assert results.has_diverged.tolist() == [True]
    assert results.has_terminated.tolist() == [False]
    assert results.steps.tolist() == [6]
    assert results.score.tolist() == [0]
    assert results.success.tolist() == [False]
    assert results.returns[CONTROLLER].tolist() == before[-1:]
    assert before[-1] != 0


def test_of_the_ends_by_their_own_rule_the_task_says_which_are_falls():
    results = _run(_rollout(), [_task(0, [make_seed(terminates_after=steps) for steps in (4, 5, 6)])])[0]
    assert results.has_terminated.tolist() == [True, True, True]
    assert results.has_fallen.tolist() == [False, True, False]


def test_an_end_that_an_aid_makes_pays_the_last_reward_for_every_step_that_is_left():
    def play(stays_for):
        rollout = _rollout(episodes=4)
        rollout.batch.stays_for = stays_for
        seeds = [make_seed(terminates_after=4), make_seed(), make_seed(diverges_after=6), make_seed(terminates_after=5)]
        return _run(rollout, [_task(0, seeds, slots=range(4))])[0]

    usual, paid = play(0.0), play(-2.0)
    extra = [-2.0 * (HORIZON - 4), 0, 0, -2.0 * (HORIZON - 5)]
    assert (paid.environment_returns - usual.environment_returns).tolist() == pytest.approx(extra)
    assert (paid.returns[CONTROLLER] - usual.returns[CONTROLLER]).tolist() == pytest.approx(extra)
    assert paid.returns[PRIMITIVE].tolist() == usual.returns[PRIMITIVE].tolist()
    assert paid.score.tolist() == usual.score.tolist()


def test_an_episode_that_diverges_as_it_falls_has_diverged():
    results = _run(_rollout(episodes=1), [_task(0, [make_seed(terminates_after=5, diverges_after=5)])])[0]
    assert results.steps.tolist() == [5]
    assert results.has_diverged.tolist() == [True]
    assert results.has_terminated.tolist() == results.has_fallen.tolist() == [False]


def test_the_primitive_too_is_not_paid_for_the_step_of_a_divergence():
    def play(horizon, diverges_after):
        def on_step(task, ids, action):
            del ids, action
            task.scripts[0] = Script(terminates_after=0, diverges_after=diverges_after)  # everything else is the seed's

        rollout = _rollout(episodes=1, horizon=horizon, on_step=on_step)
        return _run(rollout, [_task(0, [make_seed()])], _generation(is_evaluation=True))[0]

    assert play(5, 0).steps.tolist() == [5]
    assert play(9, 6).steps.tolist() == [6]
    assert play(9, 6).returns[PRIMITIVE] == pytest.approx(play(5, 0).returns[PRIMITIVE])
    assert play(6, 0).returns[PRIMITIVE] != pytest.approx(play(5, 0).returns[PRIMITIVE])


@pytest.mark.parametrize("is_minimum", [True, False])
@pytest.mark.parametrize("goal_distance", [4.0, 1.0])
def test_an_episode_is_that_of_a_plain_loop(is_minimum, goal_distance):
    design = replace(DESIGN, has_minimum_goal_distance=is_minimum, goal_distance=goal_distance)
    goals = _check_against_plain_loop(design, FakeEnvironment())
    assert goals > 0 or goal_distance == 4  # otherwise nothing is told of goals reached


@pytest.mark.parametrize("name", ALONE)
def test_an_episode_of_one_level_is_that_of_a_plain_loop(name):
    goals = _check_against_plain_loop(*ALONE[name])
    assert (goals > 0) == name.startswith("primitive")


def _check_against_plain_loop(design, world):
    """Compare three episodes with those of a plain loop; return how many goals were reached in them."""
    generation = _generation(design, is_evaluation=True)
    seeds = [make_seed(draw=3), make_seed(terminates_after=18, draw=5), make_seed(terminates_after=7, draw=2)]
    task = replace(_task(3, seeds), noise_index=(21, 133)[: len(design.dims)], signs=((-1, 1)[: len(design.dims)],))
    rollout = Rollout(design, world.make, 2, EPISODES, HORIZON)
    results = _run(rollout, [task], generation)[3]
    goals = 0
    for k, seed in enumerate(seeds):
        expected = _plain_episode(design, world, generation, task, seed)
        assert results.returns[:, k] == pytest.approx(expected["returns"], rel=1e-4, abs=1e-4)
        assert results.environment_returns[k] == pytest.approx(expected["environment"], rel=1e-4, abs=1e-4)
        assert results.score[k] == pytest.approx(expected["score"], rel=1e-4, abs=1e-4)
        assert results.final_position[k] == pytest.approx(expected["position"], rel=1e-4, abs=1e-4)
        assert results.goals_reached[k] == expected["goals"]
        goals += expected["goals"]
    return goals


def _plain_episode(design, made_by, generation, task, seed):
    """Run one episode with one robot, one step at a time, as the specification says."""
    noise = _table().values

    def policy(level, observation):
        mlp, parameters = design.policies[level], generation.levels[level]
        start = task.noise_index[level]
        epsilon = noise[start : start + mlp.num_params].astype(float)
        rest = parameters.theta.astype(float) + task.signs[0][level] * SIGMA * epsilon
        x = np.clip((observation - parameters.mean) * parameters.inverse_std, -5, 5)
        for fan_in, fan_out in zip(mlp.sizes, mlp.sizes[1:], strict=False):
            weights, biases = rest[: fan_in * fan_out].reshape(fan_in, fan_out), rest[fan_in * fan_out :][:fan_out]
            rest = rest[fan_in * fan_out + fan_out :]
            x = np.tanh(x @ weights + biases)
        return x

    world = made_by.make(1)
    world.reset([0], [seed])
    paid = dict.fromkeys(("controller", "primitive", "policy"), 0.0)
    goal, start_distance, reached, is_reached = None, 0.0, 0, False
    for step in range(HORIZON):
        seen, place = world.observe()[0], world.position[0].copy()
        inputs = seen
        if "primitive" in design.level_names:
            if step % INTERVAL == 0:
                if "controller" in design.level_names:
                    vector = policy(0, seen) * design.goal_distance
                    if design.has_minimum_goal_distance:
                        vector = np.array([math.copysign(max(abs(v), math.sqrt(0.5)), v) for v in vector])
                    goal = place + vector
                else:
                    goal = world.goal[0].copy()
                start_distance, is_reached = math.dist(goal, place), False
            dx, dy = goal - place
            bearing = math.atan2(dy, dx) - world.heading[0]
            inputs = np.array([math.sin(bearing), math.cos(bearing), math.hypot(dx, dy) / 1000, *seen])
        if design.clock is not None:
            phase = 2 * math.pi * design.clock.frequency_hz * design.clock.step_s * step
            features = 3 if goal is not None else 0
            inputs = np.array([*inputs[:features], math.sin(phase), math.cos(phase), *inputs[features:]])
        world.step(np.array([0]), policy(len(design.dims) - 1, inputs)[None])
        paid["controller"] += world.reward[0]
        paid["policy"] += world.reward[0]
        if goal is not None:
            distance = math.dist(goal, world.position[0])
            paid["primitive"] += 1 - distance / start_distance + (1 if distance < 1 else 0)
            reached += distance < 1 and not is_reached
            is_reached |= distance < 1
        if world.terminated[0]:
            break
    return {
        "returns": [paid[name] for name in design.level_names],
        "environment": paid["policy"],
        "score": world.score[0],
        "position": world.position[0],
        "goals": reached,
    }


@pytest.mark.parametrize("name", ALONE)
def test_results_of_one_level_do_not_depend_on_lanes_order_or_company(name):
    design, world = ALONE[name]
    generation, rng = _generation(design), random.Random(1)  # noqa: S311 - seeds of a test
    tasks = [
        replace(_task(m, [rng.randrange(2**63) for _ in range(EPISODES)]), noise_index=(7 * m,), signs=((1 - m % 3,),))
        for m in range(6)
    ]
    alone = {
        task.member: _bits(_run(Rollout(design, world.make, 1, EPISODES, HORIZON), [task], generation)[task.member])
        for task in tasks
    }
    assert len({bits for member in alone.values() for bits in member}) == 6 * EPISODES
    for lanes, order in ((2, tasks), (5, tasks[::-1])):
        rollout = Rollout(design, world.make, lanes, EPISODES, HORIZON)
        assert {m: _bits(r) for m, r in _run(rollout, order, generation).items()} == alone


def test_what_the_environment_paid_is_kept_beside_what_a_level_was_paid(population):
    design, world = ALONE["primitive"]
    tasks = [replace(_task(0, population[0].seeds), noise_index=(0,), signs=((1,),))]
    alone = _run(Rollout(design, world.make, 1, EPISODES, HORIZON), tasks, _generation(design))[0]
    assert not np.isclose(alone.returns[0], alone.environment_returns).any()
    both = _run(_rollout(1), [population[0]])[0]
    assert both.environment_returns.tolist() == both.returns[CONTROLLER].tolist()


def test_seconds_are_told_once_and_add_up_to_no_more_than_was_spent(population):
    start = perf_counter()
    results = _run(_rollout(3), population).values()
    spent = perf_counter() - start
    told = sum(result.seconds for result in results)
    assert told.shape == (len(PARTS),)
    assert told.min() >= 0
    assert 0 < told.sum() < spent


# Exploration noise -----------------------------------------------------------


def _constant_run(*, is_evaluation, seeds_of, lanes=4, horizon=60):
    """Run controllers that say (0.5, 0.5) and primitives that say 0, whatever they see.

    Returns the controls [steps, N, 2], and the goals relative to where they were set [steps, N, 2].
    """
    controls, goals = [], []

    def on_step(task, ids, action):
        del task, ids
        controls.append(np.array(action))
        goals.append(rollout.agent.goal - rollout.agent.goal_origin)

    design = replace(DESIGN, has_minimum_goal_distance=False)
    generation = _generation(design, scale=0, is_evaluation=is_evaluation)
    generation.levels[CONTROLLER].theta[-2:] = np.arctanh(0.5)
    rollout = _rollout(lanes, design=design, horizon=horizon, on_step=on_step)
    _run(rollout, [_task(member, seeds_of(member), signs=(0, 0)) for member in range(lanes)], generation)
    return np.array(controls), np.array(goals)


def _own_seeds(member):
    return [make_seed(draw=10 * member + k) for k in range(EPISODES)]


def test_evaluation_has_no_exploration_noise():
    controls, goals = _constant_run(is_evaluation=True, seeds_of=_own_seeds)
    assert not controls.any()
    assert goals == pytest.approx(2, abs=1e-5)


def test_training_adds_noise_of_a_hundredth_to_the_controls_and_to_the_controllers_output():
    assert EXPLORATION_STD == 0.01
    controls, goals = _constant_run(is_evaluation=False, seeds_of=_own_seeds)
    assert controls.std() == pytest.approx(0.01, rel=0.08)
    assert abs(controls.mean()) < 0.001
    # At each decision a new draw, held; times the goal distance of 4.
    decisions = goals[::INTERVAL] - 2
    assert abs(decisions.mean()) < 0.01
    assert decisions.std() == pytest.approx(0.04, rel=0.12)
    assert np.allclose(goals - 2, np.repeat(decisions, INTERVAL, axis=0), atol=1e-9)
    assert len(np.unique(controls)) > 0.99 * controls.size
    assert len(np.unique(decisions)) > 0.99 * decisions.size


def test_exploration_noise_is_drawn_from_the_episodes_seed_alone():
    controls, goals = _constant_run(
        is_evaluation=False, seeds_of=lambda _: [make_seed(draw=1), make_seed(draw=2), make_seed(draw=1)], lanes=2
    )
    for array in (controls, goals):
        by_row = np.moveaxis(array, 1, 0)
        assert np.allclose(by_row[0], by_row[2], atol=1e-12)
        assert np.allclose(by_row[0], by_row[3], atol=1e-12)
        assert not np.allclose(by_row[0], by_row[1])


def test_an_interval_of_one_and_one_beyond_the_horizon_work():
    for interval, decisions in ((1, HORIZON), (100, 1)):
        design = replace(DESIGN, controller_interval=interval)
        results = _run(_rollout(2, design=design), [_task(0, [make_seed(draw=k) for k in range(EPISODES)])])[0]
        assert results.moments[CONTROLLER].count.tolist() == [decisions] * EPISODES


# Policies that are not finite -----------------------------------------------------------


@pytest.mark.parametrize(("level", "name"), [(CONTROLLER, "controller"), (PRIMITIVE, "primitive")])
def test_a_policy_of_nan_is_refused_by_member_and_level(level, name):
    table = _table(8000)
    # No two members share a number of the table.
    tasks = [replace(_task(m, _own_seeds(m)), noise_index=(500 * m, 4000 + 500 * m)) for m in range(4)]
    table.values[tasks[3].noise_index[level] + DESIGN.dims[level] - 1] = np.nan
    for order in (tasks, tasks[::-1]):
        with pytest.raises(
            PolicyError,
            match=rf"member 3 returned NaN or infinity at step 0 \(parameters of its {name} are not finite\).*--sigma",
        ):
            _run(_rollout(4), order, table=table)


def test_an_observation_of_nan_is_refused_without_blaming_the_parameters():
    def on_step(task, ids, action):
        del ids, action
        task.observes_nan[4] = task.age[4] == 6

    tasks = [_task(member, _own_seeds(member)) for member in (8, 9)]
    with pytest.raises(PolicyError, match=r"member 9 returned NaN or infinity at step 7; episode seed"):
        _run(_rollout(2, on_step=on_step), tasks)


def test_the_seed_in_the_message_is_the_failing_episodes():
    def on_step(task, ids, action):
        del ids, action
        task.observes_nan[1] = True

    task = _task(0, _own_seeds(0))
    with pytest.raises(PolicyError, match=rf"episode seed {task.seeds[1]}\."):
        _run(_rollout(on_step=on_step), [task])


def test_a_rollout_works_again_after_a_policy_was_refused(population, alone):
    rollout = _rollout(3)
    table = NoiseTable(np.full(2000, np.nan, np.float32))
    with pytest.raises(PolicyError):
        _run(rollout, population, table=table)
    assert {m: _bits(r) for m, r in _run(rollout, population).items()} == alone


def test_a_lane_without_work_may_be_left_with_anything(population, alone):
    # Lane 0 is left with a policy of NaN by the run before; then only lanes 0 and 1 of 3 have work.
    rollout = _rollout(3)
    with pytest.raises(PolicyError):
        _run(rollout, population, table=NoiseTable(np.full(2000, np.nan, np.float32)))
    assert _bits(_run(rollout, population[:1])[0]) == alone[0]


# Members that share their noise ------------------------------------------------------------------------------


def _group(number, episodes, seed=0):
    """Return the task of a group of four members, of `episodes` each, around noise of its own."""
    rng = random.Random(1000 * seed + number)  # noqa: S311 - seeds of a test
    rows = 4 * episodes
    return EpisodeTask(
        member=4 * number,
        noise_index=(7 * number, 100 + 11 * number),
        signs=((1, 1), (1, -1), (-1, 1), (-1, 0)),
        slots=tuple(range(rows)),
        seeds=tuple(rng.randrange(2**63) for _ in range(rows)),
    )


def _shared_rollout(lanes, episodes, design=DESIGN):
    return Rollout(design, FakeEnvironment().make, lanes, 4 * episodes, HORIZON, members_per_lane=4)


@pytest.mark.parametrize("episodes", [1, 2])
def test_members_that_share_their_noise_get_the_same_results_in_any_lanes_and_company(episodes):
    generation = replace(_generation(), episodes_per_policy=episodes, members_per_lane=4)
    tasks = [_group(number, episodes) for number in range(7)]
    alone = {t.member: _bits(_run(_shared_rollout(1, episodes), [t], generation)[t.member]) for t in tasks}
    assert len({bits for group in alone.values() for bits in group}) == 7 * 4 * episodes
    for lanes, order in ((3, tasks), (5, tasks[::-1])):
        found = _run(_shared_rollout(lanes, episodes), order, generation)
        assert {m: _bits(r) for m, r in found.items()} == alone
    for slots in ((0,), (2,), (3, 1)):  # some of the episodes alone, as the last ones are handed out
        some = [replace(t, slots=slots, seeds=tuple(t.seeds[s] for s in slots)) for t in tasks]
        for member, results in _run(_shared_rollout(4, episodes), some, generation).items():
            assert _bits(results) == [alone[member][slot] for slot in slots]


def test_members_that_share_their_noise_do_as_they_would_alone():
    generation = replace(_generation(), episodes_per_policy=1, members_per_lane=4)
    for number in range(4):
        group = _group(number, 1)
        together = _run(_shared_rollout(2, 1), [group], generation)[group.member]
        for m, signs in enumerate(group.signs):
            task = replace(group, member=group.member + m, signs=(signs,), slots=(0,), seeds=group.seeds[m : m + 1])
            alone = _run(_rollout(1, episodes=1), [task], replace(generation, members_per_lane=1))[task.member]
            assert together.steps[m] == alone.steps[0]
            np.testing.assert_allclose(together.returns[:, m], alone.returns[:, 0], rtol=1e-4, atol=1e-4)
            np.testing.assert_allclose(together.final_position[m], alone.final_position[0], rtol=1e-4, atol=1e-4)


def test_a_bad_policy_of_a_group_is_named_by_its_member():
    generation = replace(_generation(), episodes_per_policy=2, members_per_lane=4)
    group = _group(3, 2)
    group = replace(group, slots=(5,), seeds=group.seeds[5:6])
    generation.levels[PRIMITIVE].theta[0] = np.nan
    with pytest.raises(PolicyError, match=r"member 14 .*parameters of its primitive are not finite"):
        _run(_shared_rollout(2, 2), [group], generation)
