"""Agents that see from the robot's own frame, on tasks of the ant: what the agent contract says, with real states.

The contract's made-up task shows five values, which are nobody's body.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.runs.build import build_algorithm, build_task
from shes.training.make_config import make_config

INTERVAL = 4
EPISODES = 2
STEPS = 2 * INTERVAL + 2
MEMBERS = 4
SETTINGS = {
    "primitive_view": "egocentric",
    "symmetry": "dihedral",
    "controller_interval": INTERVAL,
    "clock_frequency": 1.2,
    "hidden": (6, 5),
    "biases": "glorot_normal",
}
WITH_CONTROLLER = {"controller_output": "heading_vector", "controller_view": "egocentric"}
AGENTS = {
    "ant-gather": {**SETTINGS, **WITH_CONTROLLER},
    "ant-maze": {**SETTINGS, **WITH_CONTROLLER, "symmetry": "rotation", "goal_encoding": "vector"},
    "ant-push": {**SETTINGS, "controller_output": "vector", "goal_encoding": "unit_vector"},
    "ant-flagrun": SETTINGS,
}


@dataclass
class Shown:
    """What agents of one environment are shown: arrays [T, M, E, ...] of every member's episodes."""

    design: object
    robot: object
    names: tuple
    proprioception: np.ndarray
    observation: np.ndarray
    position: np.ndarray
    heading: np.ndarray
    goal: np.ndarray

    def rows(self, step, members):
        """Return the arguments of `act`: members under each other."""
        return {
            name: getattr(self, name)[step][list(members)].reshape(-1, *getattr(self, name).shape[3:])
            for name in ("observation", "position", "heading", "goal")
        }


@pytest.fixture(scope="module", params=AGENTS)
def shown(request):
    """Ants that are pushed at random, and turned and tilted to begin with."""
    config = make_config(request.param, "smoke", {**AGENTS[request.param], "reset_noise": 0.5})
    task, rng, seen = build_task(config, MEMBERS * EPISODES, is_evaluation=False), np.random.default_rng(0), []
    ids = np.arange(MEMBERS * EPISODES)
    task.reset(ids, ids.tolist())
    for step in range(STEPS):
        goal = rng.uniform(-4, 4, (len(ids), 2)) + task.position if step % INTERVAL == 0 else seen[-1][3]
        seen.append((task.observe().copy(), task.position.copy(), task.heading.copy(), goal))
        task.step(ids, rng.uniform(-30, 30, (len(ids), task.action_size)))
    arrays = [np.array(each).reshape(STEPS, MEMBERS, EPISODES, *each[0].shape[1:]) for each in zip(*seen, strict=True)]
    return Shown(build_algorithm(config).design, task.robot, task.observation_names, task.proprioception, *arrays)


def _thetas(design, member, scale=1.0):
    rng = np.random.default_rng([8, member])
    return [scale * policy.initial(rng, "glorot_normal") for policy in design.policies]


def _normalisation(design):
    rng, levels = np.random.default_rng(9), []
    for theta, size in zip(_thetas(design, 99), design.observation_sizes, strict=True):
        statistics = ObservationStatistics.empty(size).merge(4, rng.normal(size=size), rng.uniform(4, 9, size))
        levels.append(LevelParameters.of(theta, statistics))
    return tuple(levels)


def _agent(design, members):
    agent = design.make(len(members), EPISODES)
    agent.normalise_by(_normalisation(design))
    for place, member in enumerate(members):
        for level, theta in enumerate(_thetas(design, member)):
            agent.theta[level][place] = theta
    agent.start(slice(None))
    return agent


def test_controls_do_not_depend_on_lanes_company_or_when_the_others_began(shown):
    def play(members, delays):
        agent, controls = _agent(shown.design, members), {member: [] for member in members}
        for step in range(STEPS + max(delays)):
            rows = []
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if step == delay > 0:
                    agent.start(np.array([place]))
                rows.append(shown.rows(min(max(step - delay, 0), STEPS - 1), [member]))
            out = agent.act(**{name: np.concatenate([each[name] for each in rows]) for name in rows[0]})
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if delay <= step < STEPS + delay:
                    controls[member].append(out.reshape(len(members), -1)[place].tobytes())
        return controls

    alone = {member: play([member], [0])[member] for member in range(MEMBERS)}
    assert len({bits for controls in alone.values() for bits in controls}) == MEMBERS * STEPS
    for members, delays in (([0, 1, 2, 3], [0, 0, 0, 0]), ([3, 1, 0], [0, 1, 5]), ([2, 3], [3, 0])):
        assert play(members, delays) == {member: alone[member] for member in members}


def _own(shown, observation):
    """Return the egocentric view of one observation [V] and the angle of its frame."""
    qpos, qvel = np.split(observation[shown.proprioception][None], [shown.robot.num_qpos], axis=1)
    angle, out = shown.robot.frame_angle(qpos), np.zeros((1, len(shown.robot.egocentric)))
    shown.robot.write_egocentric(qpos, qvel, angle, out)
    return out[0], angle[0]


def _turned_back(vector, angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ vector


def _element_as_matrices(group, element):
    """Return what an element makes of a view [V, V] and of a vector [2, 2]."""
    size = group.view_index.shape[1]
    view = np.zeros((size, size))
    view[range(size), group.view_index[element]] = group.view_sign[element]
    cosine, sine, mirror = (each[element] for each in group.direction())
    return view, np.array([[cosine, sine], [-mirror * sine, mirror * cosine]])


def test_recording_sums_what_each_level_saw(shown):
    """The primitive sees from the frame that was chosen when its goal was set; the controller from the robot's own."""
    design, members = shown.design, [0, 1]
    agent = _agent(design, members)
    agent.is_recording = True
    rows = len(members) * EPISODES
    sums = [np.zeros((rows, size)) for size in design.observation_sizes]
    squares = [np.zeros((rows, size)) for size in design.observation_sizes]
    elements, group = np.zeros(rows, int), design.symmetry
    used = set()
    for step in range(STEPS):
        seen = shown.rows(step, members)
        agent.act(**seen)
        for row in range(rows):
            own, angle = _own(shown, seen["observation"][row])
            vector = _turned_back(agent.goal[row] - seen["position"][row], angle)
            if step % INTERVAL == 0:
                elements[row] = group.choose(vector[:1], vector[1:])[0]
                used.add(int(elements[row]))
                if len(design.policies) == 2:
                    names = {each.name for each in (*shown.robot.pose, *shown.robot.velocity)}
                    others = [i for i, name in enumerate(shown.names) if name not in names]
                    whole = seen["observation"][row]
                    is_egocentric = design.controller_view.is_egocentric
                    controller = np.concatenate([own, whole[others]]) if is_egocentric else whole
                    sums[0][row] += controller
                    squares[0][row] += controller**2
            view, direction = _element_as_matrices(group, elements[row])
            features, vector = np.zeros((1, design.goal_encoding.size)), direction @ vector
            design.goal_encoding.encode(vector[None], np.hypot(*vector)[None], np.zeros(1), features)
            turns = 2 * np.pi * 1.2 * 0.1 * step
            inputs = np.concatenate([features[0], [np.sin(turns), np.cos(turns)], view @ own])
            sums[-1][row] += inputs
            squares[-1][row] += inputs**2
    assert len(used) > 2
    for level, moments in enumerate(agent.moments):
        is_acting = level == len(design.policies) - 1
        assert moments.count.tolist() == [STEPS if is_acting else -(-STEPS // INTERVAL)] * rows
        assert moments.total == pytest.approx(sums[level], abs=1e-9)
        assert moments.total_squares == pytest.approx(squares[level], abs=1e-9)


def test_a_controllers_heading_vector_is_ahead_and_left_of_the_heading(shown):
    if len(shown.design.policies) == 1:
        return  # its environment sets the goals
    design = replace(shown.design, has_minimum_goal_distance=False)
    agents = [_agent(design, [0]) for _ in range(2)]
    seen = shown.rows(0, [0])
    for agent, turn in zip(agents, (0.0, np.pi / 2), strict=True):
        agent.act(**{**seen, "heading": seen["heading"] + turn})
    before, after = (agent.goal - seen["position"] for agent in agents)
    quarter = np.stack([-before[:, 1], before[:, 0]], axis=1)
    is_relative = design.controller_output.__class__.__name__.startswith("Heading")
    assert after == pytest.approx(quarter if is_relative else before, abs=1e-9)


def test_members_that_share_their_noise_act_as_if_each_had_its_own_policy(shown):
    """Two members a lane: the mean plus and minus the noise."""
    design, sigma = shown.design, 0.2
    levels = _normalisation(design)
    shared = design.make(MEMBERS // 2, 2 * EPISODES, shares_noise=True)
    shared.normalise_by(levels)
    shared.centre_on(levels)
    own = design.make(MEMBERS, EPISODES)
    own.normalise_by(levels)
    for level, mean in enumerate(levels):
        for lane in range(MEMBERS // 2):
            noise = _thetas(design, lane)[level]
            shared.theta[level][lane] = noise
            shared.scale[level][lane, :, 0] = np.repeat([sigma, -sigma], EPISODES)
            for side, sign in enumerate((1, -1)):
                own.theta[level][2 * lane + side] = mean.theta + np.float32(sign * sigma) * noise
    shared.start(slice(None))
    own.start(slice(None))
    for step in range(STEPS):
        seen = shown.rows(step, range(MEMBERS))
        assert shared.act(**seen) == pytest.approx(own.act(**seen), abs=1e-3)  # of 30
        assert shared.goal == pytest.approx(own.goal, abs=1e-5)


def test_controls_stay_as_they_are_in_the_next_step_and_arguments_as_they_were(shown):
    agent = _agent(shown.design, [0, 1])
    for step in range(STEPS - 1):
        seen = shown.rows(step, [0, 1])
        before = {name: array.copy() for name, array in seen.items()}
        for array in seen.values():
            array.flags.writeable = False
        controls = agent.act(**seen)
        kept = controls.copy()
        agent.act(**shown.rows(step + 1, [0, 1]))
        assert controls.tobytes() == kept.tobytes()
        assert all(np.array_equal(seen[name], array) for name, array in before.items())
