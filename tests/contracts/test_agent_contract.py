"""What every agent promises to the roll-out, over every kind of agent and each of its options.

A new goal encoding, controller output or primitive reward inherits all of it by its line in the registry; a new kind of
agent by a line in `tests.hierarchy.designs`.
"""

import pickle  # designs travel to worker processes
from dataclasses import dataclass, replace

import numpy as np
import pytest

from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.agent import AgentBatch
from tests.hierarchy.designs import ACTIONS, INTERVAL, OBSERVED, every_design

DESIGNS = every_design()
EPISODES = 2
STEPS = 2 * INTERVAL + 2

pytestmark = pytest.mark.parametrize(
    "design",
    [
        pytest.param(design, id=name, marks=() if is_chosen else pytest.mark.slow)
        for name, (design, is_chosen) in DESIGNS.items()
    ],
)


@dataclass
class Seen:
    """What a set of policies is shown in one step of its episodes: rows [E, ...]."""

    observation: np.ndarray
    position: np.ndarray
    heading: np.ndarray
    goal: np.ndarray

    def arrays(self):
        return {"observation": self.observation, "position": self.position, "heading": self.heading, "goal": self.goal}


def _script(member, steps=STEPS, episodes=EPISODES):
    """Return what member `member` is shown, step by step."""
    rng = np.random.default_rng([7, member])
    return [
        Seen(
            observation=rng.normal(size=(episodes, OBSERVED)),
            position=rng.uniform(-5, 5, (episodes, 2)),
            heading=rng.uniform(-3, 3, episodes),
            goal=rng.uniform(-5, 5, (episodes, 2)),
        )
        for _ in range(steps)
    ]


def _thetas(design, member, scale=1.0):
    rng = np.random.default_rng([8, member])
    return [scale * policy.initial(rng, "glorot_normal") for policy in design.policies]


def _normalisation(design):
    rng = np.random.default_rng(9)
    levels = []
    for theta, size in zip(_thetas(design, 0), design.observation_sizes, strict=True):
        statistics = ObservationStatistics.empty(size).merge(4, rng.normal(size=size), rng.uniform(4, 9, size))
        levels.append(LevelParameters.of(theta, statistics))
    return tuple(levels)


def _agent(design, members, episodes=EPISODES, scale=1.0):
    agent = design.make(len(members), episodes)
    agent.normalise_by(_normalisation(design))
    for place, member in enumerate(members):
        for level, theta in enumerate(_thetas(design, member, scale)):
            agent.theta[level][place] = theta
        agent.start(np.array([place]))
    return agent


def _together(seen):
    """Put the rows of several members under each other."""
    return {
        name: np.concatenate([each.arrays()[name] for each in seen])
        for name in ("observation", "position", "heading", "goal")
    }


def _act(agent, arrays, **noise):
    return agent.act(arrays["observation"], arrays["position"], arrays["heading"], goal=arrays["goal"], **noise)


def _play_alone(design, member, steps=STEPS):
    """Return controls, goals reached and the reward within, step by step, of a member alone in its agent."""
    agent, played = _agent(design, [member]), []
    for seen in _script(member, steps):
        controls = _act(agent, _together([seen]))
        # Every third step ends where the goal is.
        at = agent.goal if agent.goal is not None and agent.clock[0] % 3 == 0 else seen.position
        reward = agent.intrinsic_reward(at.copy())
        played.append((controls.tobytes(), reward.tobytes(), agent.goals_reached.tolist()))
    return played


def test_a_design_knows_its_levels(design):
    names = design.level_names
    assert 1 <= len(names) == len(set(names)) == len(design.policies) == len(design.dims)
    assert design.dims == tuple(policy.num_params for policy in design.policies)
    assert design.observation_sizes == tuple(policy.sizes[0] for policy in design.policies)
    assert design.policies[-1].sizes[-1] == ACTIONS  # the level that acts every step comes last
    assert design.intrinsic_level is None or names[design.intrinsic_level] == "primitive"
    assert design.intrinsic_level in (None, len(names) - 1)
    assert design.controller_interval >= 1
    assert design.decision_size == (design.policies[0].sizes[-1] if len(names) == 2 else 0)
    assert design.clock_size == (0 if design.clock is None else 2)


def test_a_design_travels_to_another_process(design):
    arrived = pickle.loads(pickle.dumps(design))  # noqa: S301 - our own bytes
    assert (arrived.level_names, arrived.dims) == (design.level_names, design.dims)
    first, other = ([_act(_agent(d, [3]), _together([_script(3)[0]])).tobytes()] for d in (design, arrived))
    assert first == other


def test_an_agent_has_room_for_all_its_policies(design):
    agent = design.make(3, EPISODES)
    assert isinstance(agent, AgentBatch)
    assert (agent.num_lanes, agent.rows_per_lane) == (3, EPISODES)
    assert [theta.shape for theta in agent.theta] == [(3, dim) for dim in design.dims]
    assert {theta.dtype for theta in agent.theta} == {np.dtype(np.float32)}
    assert [moments.total.shape for moments in agent.moments] == [(6, size) for size in design.observation_sizes]
    assert (agent.clock.shape, agent.goals_reached.shape) == ((3,), (6,))
    assert (agent.goal is None) == (design.intrinsic_level is None)
    assert agent.goal is None or agent.goal.shape == (6, 2)


@pytest.mark.parametrize("episodes", [1, EPISODES])
def test_actions_do_not_depend_on_lanes_company_or_when_the_others_began(design, episodes):
    steps = STEPS

    def play(members, delays):
        agent, controls = _agent(design, members, episodes), {member: [] for member in members}
        scripts = {member: _script(member, steps, episodes) for member in members}
        for step in range(steps + max(delays)):
            shown = []
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if step == delay:
                    agent.start(np.array([place]))
                shown.append(scripts[member][min(max(step - delay, 0), steps - 1)])
            out = _act(agent, _together(shown)).reshape(len(members), -1)
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if delay <= step < steps + delay:
                    controls[member].append(out[place].tobytes())
        return controls

    alone = {member: play([member], [0])[member] for member in range(4)}
    assert len({bits for controls in alone.values() for bits in controls}) == 4 * steps
    for members, delays in (([0, 1, 2, 3], [0, 0, 0, 0]), ([3, 1, 0], [0, 1, 5]), ([2, 3], [3, 0])):
        assert play(members, delays) == {member: alone[member] for member in members}


def test_an_episode_does_not_depend_on_those_before_it_in_its_lane(design):
    agent = _agent(design, [1, 2])
    agent.is_recording = True
    for seen in zip(_script(5), _script(6), strict=True):
        _act(agent, _together(seen))
        agent.intrinsic_reward(agent.goal if agent.goal is not None else np.zeros((4, 2)))
    for level, theta in enumerate(_thetas(design, 3)):
        agent.theta[level][1] = theta
    agent.start(np.array([1]))
    assert agent.clock.tolist() == [STEPS, 0]
    assert not agent.goals_reached[EPISODES:].any()
    assert all(not m.count[EPISODES:].any() and not m.total[EPISODES:].any() for m in agent.moments)
    assert all(not m.total_squares[EPISODES:].any() for m in agent.moments)
    if design.intrinsic_level is not None:
        assert agent.goals_reached[:EPISODES].all()  # the other lane goes on
    assert agent.moments[-1].count[:EPISODES].tolist() == [STEPS] * EPISODES
    fresh = _agent(design, [3])
    for seen in _script(3):
        mine = _act(agent, _together([_script(6)[0], seen]))[EPISODES:]
        assert mine.tobytes() == _act(fresh, _together([seen])).tobytes()


def test_without_noise_controls_are_within_their_limit_and_scale_with_it(design):
    wide = replace(design, control_limit=30.0)
    strong = {}
    for name, each in (("unit", design), ("wide", wide)):
        agent = _agent(each, [0, 1], scale=20)
        strong[name] = np.array([_act(agent, _together(seen)) for seen in zip(_script(0), _script(1), strict=True)])
    assert strong["unit"].shape == (STEPS, 2 * EPISODES, ACTIONS)
    assert strong["unit"].dtype == np.float32
    assert 0.9 < np.abs(strong["unit"]).max() <= 1
    assert strong["wide"] == pytest.approx(30 * strong["unit"], rel=1e-6)


def test_noise_on_the_controls_is_added_in_units_of_control(design):
    design = replace(design, control_limit=30.0)
    noise = np.random.default_rng(0).normal(size=(2, EPISODES, ACTIONS)).astype(np.float32)
    seen = _together([_script(0)[0], _script(1)[0]])
    clean, noisy = (_act(_agent(design, [0, 1]), seen, control_noise=each) for each in (None, noise))
    assert noisy - clean == pytest.approx(noise.reshape(-1, ACTIONS), abs=1e-4)


def test_noise_on_decisions_moves_goals_and_nothing_else(design):
    agents = [_agent(design, [0, 1]) for _ in range(2)]
    noise = np.full((2, EPISODES, design.decision_size), 0.2, np.float32)
    for seen in zip(_script(0), _script(1), strict=True):
        clean, noisy = _act(agents[0], _together(seen)), _act(agents[1], _together(seen), decision_noise=noise)
    assert np.array_equal(clean, noisy) == (design.decision_size == 0)
    if design.decision_size == 0 and agents[0].goal is not None:
        assert np.array_equal(agents[0].goal, agents[1].goal)


def test_acting_changes_none_of_its_arguments(design):
    agent = _agent(design, [0, 1])
    agent.is_recording = True
    noise = {
        "control_noise": np.ones((2, EPISODES, ACTIONS), np.float32),
        "decision_noise": np.ones((2, EPISODES, design.decision_size), np.float32),
    }
    for array in noise.values():
        array.flags.writeable = False
    for seen in zip(_script(0), _script(1), strict=True):
        arrays = _together(seen)
        before = {name: array.copy() for name, array in arrays.items()}
        for array in arrays.values():
            array.flags.writeable = False
        _act(agent, arrays, **noise)
        agent.intrinsic_reward(arrays["position"])
        assert all(np.array_equal(arrays[name], array) for name, array in before.items())


def test_controls_and_goals_are_not_overwritten_by_the_next_step(design):
    agent = _agent(design, [0])
    first, second = (_together([seen]) for seen in _script(0)[:2])
    controls = _act(agent, first)
    kept = controls.copy()
    _act(agent, second)
    assert np.array_equal(controls, kept)
    if agent.goal is not None:
        held = agent.goal.copy()
        first["goal"][:] = 99  # the environment's array is live; the goal that is held is not
        second["goal"][:] = 99
        assert np.array_equal(agent.goal, held)


def test_the_clock_counts_the_steps_of_each_set(design):
    agent = _agent(design, [0, 1])
    for step, seen in enumerate(zip(_script(0), _script(1), strict=True)):
        if step == 3:
            agent.start(np.array([1]))
        _act(agent, _together(seen))
    assert agent.clock.tolist() == [STEPS, STEPS - 3]


def _expected_inputs(design, step, seen, goal):
    """Return what the acting level is to see [E, O]: goal features, clock, what it views of the observation."""
    parts = []
    if goal is not None:
        vector = goal - seen.position
        features = np.zeros((EPISODES, design.goal_encoding.size))
        design.goal_encoding.encode(vector, np.hypot(*vector.T), seen.heading, features)
        parts.append(features)
    if design.clock is not None:
        turns = design.clock.frequency_hz * design.clock.step_s * step
        parts.append(np.tile([np.sin(2 * np.pi * turns), np.cos(2 * np.pi * turns)], (EPISODES, 1)))
    view = getattr(design, "primitive_view", None)
    indices = None if view is None else view.indices
    parts.append(seen.observation if indices is None else seen.observation[:, list(indices)])
    return np.hstack(parts)


def test_recording_sums_what_each_level_saw(design):
    agent = _agent(design, [0, 1])
    agent.is_recording = True
    sums = [np.zeros((2 * EPISODES, size)) for size in design.observation_sizes]
    squares = [np.zeros((2 * EPISODES, size)) for size in design.observation_sizes]
    counts = [np.zeros(2 * EPISODES) for _ in design.dims]
    steps = [0, 0]
    for number, both in enumerate(zip(_script(0), _script(1), strict=True)):
        if number == 2:  # the second set begins anew, and forgets what it saw
            agent.start(np.array([1]))
            steps[1] = 0
            for array in (*sums, *squares, *counts):
                array[EPISODES:] = 0
        _act(agent, _together(both))
        for lane, seen in enumerate(both):
            rows = slice(lane * EPISODES, (lane + 1) * EPISODES)
            inputs = _expected_inputs(design, steps[lane], seen, None if agent.goal is None else agent.goal[rows])
            levels = [(len(design.dims) - 1, inputs)]
            if len(design.dims) == 2 and steps[lane] % INTERVAL == 0:
                levels.append((0, seen.observation))
            for level, shown in levels:
                sums[level][rows] += shown
                squares[level][rows] += shown**2
                counts[level][rows] += 1
            steps[lane] += 1
    for level, moments in enumerate(agent.moments):
        assert moments.count.tolist() == counts[level].tolist()
        assert moments.total == pytest.approx(sums[level], abs=1e-9)
        assert moments.total_squares == pytest.approx(squares[level], abs=1e-9)


def test_nothing_is_recorded_unless_asked_for(design):
    agent = _agent(design, [0])
    for seen in _script(0):
        _act(agent, _together([seen]))
    assert not any(moments.count.any() or moments.total.any() for moments in agent.moments)


def test_goals_are_held_for_the_interval_and_are_those_that_count(design):
    agent, held = _agent(design, [0]), []
    script = _script(0)
    for seen in script:
        _act(agent, _together([seen]))
        held.append(None if agent.goal is None else agent.goal.copy())
    if design.intrinsic_level is None:
        assert held == [None] * STEPS
        return
    for step, goal in enumerate(held):
        begun = step - step % INTERVAL
        assert np.array_equal(goal, held[begun])
        if len(design.dims) == 1:
            assert np.array_equal(goal, script[begun].goal)
    assert not np.array_equal(held[0], held[INTERVAL])


def test_every_goal_is_reached_once_at_most(design):
    agent = _agent(design, [0, 1])
    far = np.full((2 * EPISODES, 2), 1000.0)
    history = []
    for both in zip(_script(0), _script(1), strict=True):
        _act(agent, _together(both))
        near = far.copy()
        if agent.goal is not None:
            near[0] = agent.goal[0]  # the first episode is where its goal is, the others never
        for place in (near, far, near):
            agent.intrinsic_reward(place)
        history.append(agent.goals_reached.tolist())
    reached = design.intrinsic_level is not None
    assert history == [[(1 + step // INTERVAL) * reached, 0, 0, 0] for step in range(STEPS)]


def test_an_agent_that_pays_nobody_pays_nothing(design):
    agent = _agent(design, [0])
    seen = _script(0)[0]
    _act(agent, _together([seen]))
    paid = agent.intrinsic_reward(seen.position + 0.3)
    assert paid.shape == (EPISODES,)
    assert np.isfinite(paid).all()
    assert paid.any() == (design.intrinsic_level is not None)


def test_play_does_not_depend_on_what_another_agent_of_the_design_did(design):
    first = _play_alone(design, 2)
    _play_alone(design, 3)
    assert _play_alone(design, 2) == first
