"""Agents where the contract's random numbers do not lead: at the edges of goals, and with a symmetric controller."""

import math

import numpy as np
import pytest

from shes.agents.agent import AgentInputs
from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.rollout import designs


def deciding(output, lanes=1, **options):
    """Return agents at the first step of their episodes whose controllers output `output`, whatever they see."""
    design = designs.both(hidden=(), **options)
    agent = design.agent(design, lanes, 1)
    agent.levels[0].theta[:, -2:] = np.arctanh(output)
    agent.start(slice(None))
    return agent


def act(agent, position):
    position = np.broadcast_to(np.array(position, float), (agent.num_rows, 2)).copy()
    agent.act(AgentInputs(np.zeros((agent.num_rows, designs.OBSERVED)), position, np.zeros(agent.num_rows)))
    return agent.goal - position


@pytest.mark.parametrize(
    ("output", "pushed"),
    [
        ((0.05, -0.1), (0.70711, -0.70711)),  # 0.2 and -0.4 m: both are pushed
        ((0.0, 0.5), (0.70711, 2.0)),  # 0 goes to the positive side
        ((-0.17, -0.18), (-0.70711, -0.72)),  # just under, just over
    ],
)
def test_a_near_goal_is_pushed_outward_by_component(output, pushed):
    assert act(deciding(output), (3, 3))[0] == pytest.approx(pushed, abs=1e-5)
    assert act(deciding(output, is_minimum=False), (3, 3))[0] == pytest.approx(4 * np.array(output), abs=1e-6)


def test_progress_is_exact_where_the_robot_stays():
    """It is 0; and the whole with the bonus for a goal where the robot stands."""
    agent, position = deciding((0.3, 0.7), lanes=50), np.random.default_rng(0).normal(size=(50, 2)) * 10
    act(agent, position)
    assert agent.intrinsic_reward(position).tolist() == [0] * 50
    agent = deciding((0, 0), is_minimum=False)
    act(agent, (5, 5))
    assert agent.intrinsic_reward(np.array([[5.0, 5.0]])).tolist() == [2]
    assert np.isfinite(agent.intrinsic_reward(np.array([[10.0, 5.0]]))).all()


@pytest.mark.parametrize("change", ["mirror", "turn"])
def test_an_equivariant_controller_follows_a_changed_world(change):
    """Normalisation included. The heading stays as it is, so a controller that sees it answers mirrored worlds only."""
    equivariant = {"controller_network": "equivariant", "controller_view": "sectors", "minimum_goal_distance": False}
    config = make_config("point-gather", "smoke", {**equivariant, "controller_output": "heading_direction"})
    design, rng = build_algorithm(config).design, np.random.default_rng(5)
    (network, primitive), view = design.policies, design.controller_view
    theta = rng.normal(0, 0.5, network.num_params).astype(np.float32)
    if change == "turn":
        of_heading = network.index[: network.sizes[0] * network.sizes[1]].reshape(8, 10, -1)[4]
        theta[np.unique(of_heading)] = 0
    total, squares = rng.uniform(0, 9, 80), rng.uniform(40, 60, 80)
    network.pool(total, squares)
    statistics = ObservationStatistics(count=20, total=total, total_squares=squares)
    unseen = ObservationStatistics.empty(primitive.sizes[0])
    levels = (LevelParameters.of(theta, statistics), LevelParameters.of(primitive.initial(rng), unseen))

    def goals(observation, position):
        agent = design.agent(design, 1, len(observation))
        agent.centre_on(levels)
        for own, level in zip(agent.levels, levels, strict=True):
            own.theta[0] = level.theta
        agent.start(slice(None))
        for _ in range(design.controller_interval + 1):  # until it has seen its first goal
            agent.act(AgentInputs(observation, position, np.zeros(len(observation))))
        return agent.goal - position

    observation, angle = rng.uniform(0, 1, (6, 25)), np.pi / 5
    turn = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    matrix = np.transpose([[1, 0], [0, -1]] if change == "mirror" else turn)
    rings, changed = np.array(view.rings), observation.copy()
    changed[:, rings] = observation[:, rings[:, ::-1] if change == "mirror" else np.roll(rings, 1, axis=1)]
    for columns in (view.vectors["position"], view.vectors["velocity"]):
        changed[:, columns] = observation[:, columns] @ matrix
    plain, answer = (goals(each, each[:, view.vectors["position"]]) for each in (observation, changed))
    np.testing.assert_allclose(np.hypot(*plain.T), 4.0, rtol=1e-6)
    np.testing.assert_allclose(answer, plain @ matrix, atol=1e-4)
    assert np.abs(answer - plain).max() > 0.5
