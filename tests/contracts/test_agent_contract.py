"""What every agent promises to the rollout: on made-up observations with each option, and on ants that tumble.

A goal encoding, a controller output or a primitive reward comes under it by its line in the registry, and by its
formula in `plain_agent`; a kind of agent by a line in `designs`.
"""

import pickle  # designs travel to worker processes
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from shes.agents.agent import AgentInputs
from shes.runs.build import build_algorithm, build_environment, build_options
from shes.runs.make_config import make_config
from tests.rollout.designs import INTERVAL, OBSERVED, every_design, levels_of, thetas_of
from tests.rollout.plain_agent import PlainAgent, columns, rotated

MEMBERS, EPISODES, STEPS = 4, 2, 2 * INTERVAL + 2
WALKER = {"primitive_view": "egocentric", "symmetry": "dihedral", "clock_frequency": 1.2}
EGOCENTRIC = {**WALKER, "controller_interval": INTERVAL, "hidden": (6, 5)}
WITH_CONTROLLER = {**EGOCENTRIC, "controller_output": "heading_direction", "controller_view": "egocentric"}
ANTS = {
    "ant-gather": {**WITH_CONTROLLER, "controller_view": "sectors"},
    "ant-maze": {**WITH_CONTROLLER, "symmetry": "rotation", "goal_encoding": "vector"},
    "ant-push": {**EGOCENTRIC, "controller_output": "vector", "goal_encoding": "unit_vector"},
    "ant-flagrun": EGOCENTRIC,
}
RECORDED = np.random.default_rng(3).uniform(-4, 4, (MEMBERS, 2, 2))
"""Goals that members pursue whose goals are recorded."""


@dataclass
class Subject:
    """An agent's design, and what its members are shown: arrays [T, M, E, ...] by argument of `act`."""

    design: object
    shown: dict
    see: object = columns

    def rows(self, step, members, episodes=EPISODES):
        """Return the arguments of `act`: copies, members under each other."""
        own = {name: [array[step, member, :episodes] for member in members] for name, array in self.shown.items()}
        return {name: np.concatenate(arrays) for name, arrays in own.items()}

    def start(self, agent, place, member):
        """Let the episodes of a member start in lane `place`."""
        for level, theta in enumerate(thetas_of(self.design, member)):
            agent.levels[level].theta[place] = theta
        agent.start(np.array([place]))
        if getattr(self.design, "num_recorded_goals", 0):
            agent.go_on(place, 0, RECORDED[member])

    def agent(self, members, episodes=EPISODES):
        """Return an agent in whose lanes the episodes of these members start."""
        agent = self.design.agent(self.design, len(members), episodes)
        agent.centre_on(levels_of(self.design))
        for place, member in enumerate(members):
            self.start(agent, place, member)
        return agent

    def plain(self, member):
        """Return the second implementation of one episode of a member."""
        recorded = RECORDED[member] if getattr(self.design, "num_recorded_goals", 0) else ()
        return PlainAgent(self.design, thetas_of(self.design, member), levels_of(self.design), recorded, self.see)


@lru_cache
def subject(name):
    """Return the subject of this name."""
    rng = np.random.default_rng(7)
    if name in ANTS:
        return tumbling(name, rng)
    shape = (STEPS, MEMBERS, EPISODES)
    shown = {
        "observation": rng.normal(size=(*shape, OBSERVED)),
        "position": rng.uniform(-5, 5, (*shape, 2)),
        "heading": rng.uniform(-3, 3, shape),
        "goal": rng.uniform(-5, 5, (*shape, 2)),
    }
    return Subject(every_design()[name], shown)


def tumbling(name, rng):
    """Return the subject of ants that are turned and tilted, and pushed at random."""
    config = make_config(name, "smoke", {**ANTS[name], "reset_noise": 0.5})
    task = build_environment(config).make(MEMBERS * EPISODES, build_options(config, is_evaluation=False))
    seen, ids = [], np.arange(MEMBERS * EPISODES)
    task.reset(ids, ids.tolist())
    for _ in range(STEPS):
        goal = rng.uniform(-4, 4, (len(ids), 2)) + task.position
        seen.append((task.observe().copy(), task.position.copy(), task.heading.copy(), goal))
        task.step(ids, rng.uniform(-30, 30, (len(ids), task.action_size)))
    arrays = [np.array(each).reshape(STEPS, MEMBERS, EPISODES, *each[0].shape[1:]) for each in zip(*seen, strict=True)]
    robot = {each.name for each in (*task.robot.pose, *task.robot.velocity)}
    others = [i for i, each in enumerate(task.observation_names) if each not in robot]

    def see(view, observation, heading):
        if view.sees_last_goal:
            middles = np.arange(-0.9, 1, 0.2) * np.pi
            readings = observation[task.sensor_rings].ravel()
            turned = [
                rotated(observation[[x, y]] / view.units[name], -heading) for name, (x, y) in view.vectors.items()
            ]
            parts = [x * np.cos(middles) + y * np.sin(middles) for x, y in [(1, 0), *turned]]
            return np.concatenate([readings, readings**8, *parts]), heading
        if not view.is_egocentric:
            return columns(view, observation, heading)
        qpos, qvel = np.split(observation[task.proprioception][None], [task.robot.num_qpos], axis=1)
        angle, own = task.robot.frame_angle(qpos), np.zeros((1, len(task.robot.egocentric)))
        task.robot.write_egocentric(qpos, qvel, angle, own)
        rest = observation[others] if view.size(len(observation)) > own.size else []
        return np.concatenate([own[0], rest]), float(angle[0])

    shown = dict(zip(("observation", "position", "heading", "goal"), arrays, strict=True))
    return Subject(build_algorithm(config).design, shown, see)


pytestmark = pytest.mark.parametrize("name", [*every_design(), *ANTS])


def test_an_agent_acts_pays_and_sees_as_the_plain_one(name):
    """With noise; in the second lane another member's episodes go on after three steps from where they were.

    The design arrives in another process as it left, and acting writes into nothing that others hold.
    """
    of, members, rng = subject(name), [0, 1], np.random.default_rng(4)
    of = replace(of, design=pickle.loads(pickle.dumps(replace(of.design, control_limit=30.0))))  # noqa: S301 - our own
    names = tuple(of.design.networks)
    assert names in (("policy",), ("primitive",), ("controller", "primitive"))
    assert of.design.has_intrinsic_reward == (names[-1] == "primitive")
    agent, plain = of.agent(members), [of.plain(member) for member in members for _ in range(EPISODES)]
    paid, held = set(), []
    for level in agent.levels:
        level.is_recording = True
    for step in range(STEPS):
        if step == 3:
            of.start(agent, 1, 2)
            agent.go_on(1, 2 * INTERVAL, RECORDED[2])
            plain[EPISODES:] = [of.plain(2) for _ in range(EPISODES)]
            for one in plain[EPISODES:]:
                one.clock = 2 * INTERVAL
        seen = of.rows(step, members)
        noise = {
            "decision_noise": rng.normal(0, 0.1, (2, EPISODES, of.design.decision_size)).astype(np.float32),
            "control_noise": rng.normal(0, 0.1, (2, EPISODES, agent.design.policies[-1].sizes[-1])).astype(np.float32),
        }
        for array in (*seen.values(), *noise.values()):
            array.flags.writeable = False
        controls = agent.act(AgentInputs(**seen, **noise))
        held.append((controls, controls.tobytes()))
        after = seen["position"] + rng.normal(0, 0.3, (len(plain), 2))
        if agent.goal is not None and step % 3:
            after[step % 4] = agent.goal[step % 4] + (0.3, -0.2)  # one of the robots reaches its goal
        rewards = agent.intrinsic_reward(after)
        for row, one in enumerate(plain):
            own = {name: array[row] for name, array in seen.items()}
            extra = {name: array.reshape(len(plain), -1)[row] for name, array in noise.items()}
            assert controls[row] == pytest.approx(one.act(**own, **extra), rel=1e-3, abs=3e-3)
            if agent.goal is not None:
                assert agent.goal[row] == pytest.approx(one.goal, abs=1e-5)
            assert rewards[row] == pytest.approx(one.pay(after[row]), rel=1e-4, abs=1e-4)
            paid.add(round(float(rewards[row]), 3))
            assert agent.goals_reached[row] == one.goals_reached
        for array in seen.values():  # an environment's arrays are live, the goal that is held is not
            array.flags.writeable = True
            array[:] = 99
    assert all(controls.dtype == np.float32 and controls.tobytes() == before for controls, before in held)
    assert agent.clock.tolist() == [STEPS, 2 * INTERVAL + STEPS - 3]
    assert len(paid) > 10 if of.design.has_intrinsic_reward else paid == {0.0}
    assert (sum(one.goals_reached for one in plain) > 0) == of.design.has_intrinsic_reward
    for level, moments in enumerate(own.moments for own in agent.levels):
        for row, one in enumerate(plain):
            inputs = np.array(one.inputs[level])
            assert moments.count[row] == len(inputs)
            assert moments.total[row] == pytest.approx(inputs.sum(axis=0), abs=1e-4)
            assert moments.total_squares[row] == pytest.approx((inputs**2).sum(axis=0), abs=1e-3)


@pytest.mark.parametrize("episodes", [1, EPISODES])
def test_no_bit_depends_on_lanes_company_or_what_was_before(name, episodes):
    of = subject(name)

    def play(members, delays):
        agent, bits = of.agent([3] * len(members), episodes), {member: [] for member in members}
        for step in range(STEPS + max(delays)):
            rows = []
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if step == delay:
                    of.start(agent, place, member)
                rows.append(of.rows(min(max(step - delay, 0), STEPS - 1), [member], episodes))
            out = agent.act(AgentInputs(**{name: np.concatenate([each[name] for each in rows]) for name in rows[0]}))
            paid = agent.intrinsic_reward(np.ones((len(out), 2)))
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if delay <= step < STEPS + delay:
                    own = slice(place * episodes, (place + 1) * episodes)
                    bits[member].append((out[own].tobytes(), paid[own].tobytes(), agent.goals_reached[own].tolist()))
        assert not any(level.moments.count.any() for level in agent.levels)  # nobody asked for them
        return bits

    alone = {member: play([member], [0])[member] for member in range(MEMBERS)}
    assert len({controls for each in alone.values() for controls, _, _ in each}) == MEMBERS * STEPS
    for members, delays in (([0, 1, 2, 3], [0, 0, 0, 0]), ([3, 1, 0], [0, 1, 5]), ([2, 3], [3, 0])):
        assert play(members, delays) == {member: alone[member] for member in members}


def test_members_that_share_noise_act_as_without(name):
    """Two members in a lane: the mean plus and minus the noise."""
    of, sigma = subject(name), 0.2
    levels = levels_of(of.design)
    shared = of.design.agent(of.design, MEMBERS // 2, 2 * EPISODES, shares_noise=True)
    own = of.design.agent(of.design, MEMBERS, EPISODES)
    for level, mean in enumerate(levels):
        for lane in range(MEMBERS // 2):
            noise = thetas_of(of.design, lane)[level]
            shared.levels[level].theta[lane] = noise
            shared.levels[level].scale[lane, :, 0] = np.repeat([sigma, -sigma], EPISODES)
            for side, sign in enumerate((1, -1)):
                own.levels[level].theta[2 * lane + side] = mean.theta + np.float32(sign * sigma) * noise
    for agent in (shared, own):
        agent.centre_on(levels)
        agent.start(slice(None))
    for step in range(STEPS):
        seen = of.rows(step, range(MEMBERS))
        assert shared.act(AgentInputs(**seen)) == pytest.approx(own.act(AgentInputs(**seen)), abs=1e-3)
        if own.goal is not None:
            assert shared.goal == pytest.approx(own.goal, abs=1e-4)
