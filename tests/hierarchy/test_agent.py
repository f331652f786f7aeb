"""The two-level agent, driven by hand: when goals are set, where, and what the primitive is told."""

import math

import numpy as np
import pytest

from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.goals import AngleEncoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.moments import Moments
from shes.hierarchy.outputs import OneHotOutput, VectorOutput
from shes.hierarchy.rewards import ProgressReward
from shes.hierarchy.views import ColumnsView
from shes.policies.mlp import MLP
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config
from shes.types import CONTROLLER, PRIMITIVE

INTERVAL = 4
OBSERVED = 2


def _design(**changes):
    design = {
        "controller": MLP(OBSERVED, (), 2),
        "primitive": MLP(3 + OBSERVED, (), 3),
        "goal_encoding": AngleEncoding(),
        "primitive_reward": ProgressReward(),
        "controller_output": VectorOutput(),
        "goal_distance": 4.0,
        "controller_interval": INTERVAL,
        "has_minimum_goal_distance": False,
        "control_limit": 1.0,
    }
    return HierarchicalDesign(**{**design, **changes})


def _agent(num_lanes=1, rows_per_lane=1, output=(0.5, 0.25), follows=0.0, sees=None, **changes):
    """Return an agent whose controller says `output` (+ the tanh of `follows` times what it observes).

    Its primitive lets us look at the goal's features: the controls are tanh(sin), tanh(cos), tanh(distance).
    """
    design = _design(**changes)
    agent = design.make(num_lanes, rows_per_lane)
    weights = follows * np.eye(2).ravel() if sees is None else sees
    controller = np.concatenate([weights, np.arctanh(output)])
    primitive = np.zeros((3 + OBSERVED, 3))
    primitive[:3] = np.diag([1, 1, 1000])
    agent.theta[CONTROLLER][:] = controller
    agent.theta[PRIMITIVE][:] = np.concatenate([primitive.ravel(), np.zeros(3)])
    agent.normalise_by(
        tuple(
            LevelParameters.of(theta[0], ObservationStatistics.empty(size))
            for theta, size in zip(agent.theta, design.observation_sizes, strict=True)
        )
    )
    for policy in range(num_lanes):
        agent.start(np.array([policy]))
    return agent


def _act(agent, position=(0, 0), heading=0.0, observation=(0, 0), **noise):
    rows = agent.num_lanes * agent.rows_per_lane
    return agent.act(
        np.broadcast_to(np.array(observation, float), (rows, OBSERVED)).copy(),
        np.broadcast_to(np.array(position, float), (rows, 2)).copy(),
        np.broadcast_to(np.array(heading, float), rows).copy(),
        **noise,
    )


def test_the_goal_is_the_position_plus_the_controllers_vector_in_the_world_frame():
    for heading in (0.0, 1.0, -2.0):
        agent = _agent(output=(0.5, -0.75))
        _act(agent, position=(10, -20), heading=heading)
        assert agent.goal[0] == pytest.approx([12, -23], abs=1e-6)
        assert agent.goal_origin[0].tolist() == [10, -20]
        assert agent.goal_start_distance[0] == pytest.approx(math.hypot(2, 3), abs=1e-6)


def test_the_goal_is_held_for_exactly_the_interval():
    agent = _agent()
    goals = []
    for step in range(3 * INTERVAL):
        _act(agent, position=(step, 2 * step))
        goals.append(tuple(agent.goal[0].round(5).tolist()))
    expected = [(start + 2, 2 * start + 1) for start in (0, 4, 8) for _ in range(INTERVAL)]
    assert goals == expected


def test_the_controller_decides_by_what_it_sees_at_steps_0_c_2c_and_then_only():
    agent = _agent(output=(0, 0), follows=1.0)
    origins = []
    for step in range(3 * INTERVAL):
        seen = 0.1 * (step + 1)
        _act(agent, observation=(seen, -seen))
        origins.append(round(math.atanh(agent.goal[0, 0] / 4) * 10) - 1)
    assert origins == [0] * 4 + [4] * 4 + [8] * 4


def test_the_goal_is_expressed_anew_at_every_step():
    # Set at (0, 0), the goal is (2, 1). The robot comes nearer, passes below it, and turns to it.
    agent = _agent(output=(0.5, 0.25))
    for position, heading, sine, cosine, distance in (
        ((0, 0), 0, 1 / math.sqrt(5), 2 / math.sqrt(5), math.sqrt(5)),
        ((0, 1), 0, 0, 1, 2),
        ((2, 0), 0, 1, 0, 1),
        ((2, 0), math.pi / 2, 0, 1, 1),
    ):
        control = _act(agent, position=position, heading=heading)[0]
        assert control == pytest.approx(np.tanh([sine, cosine, distance]), abs=1e-5)


def test_the_primitive_sees_the_features_in_front_of_the_observation():
    agent = _agent(output=(0.5, 0))
    agent.is_recording = True
    _act(agent, observation=(7, -8))
    assert agent.moments[PRIMITIVE].total[0] == pytest.approx([0, 1, 0.002, 7, -8], abs=1e-6)
    assert agent.moments[PRIMITIVE].total_squares[0] == pytest.approx([0, 1, 4e-6, 49, 64], abs=1e-6)
    assert agent.moments[CONTROLLER].total[0].tolist() == [7, -8]


@pytest.mark.parametrize(
    ("output", "vector"),
    [
        ((0.05, -0.1), (0.70711, -0.70711)),  # (0.2, -0.4): both pushed
        ((0.0, 0.5), (0.70711, 2.0)),  # 0 goes to the positive side
        ((-0.9, 0.1), (-3.6, 0.70711)),
        ((-0.17, -0.18), (-0.70711, -0.72)),  # just under, just over
        ((0.5, 0.5), (2.0, 2.0)),  # far enough
    ],
)
def test_a_near_goal_is_pushed_outward_component_by_component(output, vector):
    agent = _agent(output=output, has_minimum_goal_distance=True)
    _act(agent, position=(3, 3))
    assert agent.goal[0] - 3 == pytest.approx(vector, abs=1e-5)
    assert agent.goal_start_distance[0] >= 1 - 1e-9
    free = _agent(output=output)
    _act(free, position=(3, 3))
    assert free.goal[0] - 3 == pytest.approx(np.array(output) * 4, abs=1e-6)


def test_the_primitive_is_paid_for_its_progress_towards_the_goal():
    agent = _agent(output=(0.75, 1 - 1e-9))  # (3, 4): 5 m away
    _act(agent)
    for position, reward in (
        ((0, 0), 0),
        ((1.5, 2), 0.5),
        ((-3, -4), -1),
        ((2.41, 3.21), 1 - math.hypot(0.59, 0.79) / 5 + 1),
        ((3, 4), 2),
    ):
        assert agent.intrinsic_reward(np.array([position]))[0] == pytest.approx(reward, abs=1e-6)


def test_a_robot_that_did_not_move_has_made_exactly_no_progress():
    agent = _agent(num_lanes=50, output=(0.3, 0.7))
    position = np.random.default_rng(0).normal(size=(50, 2)) * 10
    agent.act(np.zeros((50, OBSERVED)), position, np.zeros(50))
    assert agent.intrinsic_reward(position).tolist() == [0] * 50


def test_a_goal_where_the_robot_stands_pays_the_bonus_and_is_no_nan():
    agent = _agent(output=(0, 0))
    _act(agent, position=(5, 5))
    assert agent.intrinsic_reward(np.array([[5.0, 5.0]])).tolist() == [2]


def test_walking_away_from_a_goal_where_the_robot_stood_is_paid_something_finite():
    agent = _agent(output=(0, 0))
    _act(agent, position=(5, 5))
    assert np.isfinite(agent.intrinsic_reward(np.array([[10.0, 5.0]]))).all()


def test_a_goal_is_counted_once_when_the_robot_first_comes_near_it():
    agent = _agent(num_lanes=2, output=(0.75, 0.0))  # 3 m to the right of where it is set
    _act(agent)
    counts = []
    # Just outside 1 m, inside, further inside, outside and inside again: one goal.
    for x in (1.99, 2.01, 2.5, 0.0, 3.0):
        agent.intrinsic_reward(np.array([[x, 0.0], [0.0, 0.0]]))
        counts.append(agent.goals_reached.tolist())
    assert counts == [[0, 0], [1, 0], [1, 0], [1, 0], [1, 0]]
    for _ in range(INTERVAL):
        _act(agent, position=(3, 0))
    # A new goal at (6, 0): another one to reach.
    assert agent.goal.round(5).tolist() == [[6, 0]] * 2
    agent.intrinsic_reward(np.array([[3.0, 0.0], [6.0, 0.0]]))
    assert agent.goals_reached.tolist() == [1, 1]
    agent.intrinsic_reward(np.array([[6.0, 0.0], [6.0, 0.0]]))
    assert agent.goals_reached.tolist() == [2, 1]


def test_new_episodes_have_reached_no_goal_and_can_reach_their_first():
    agent = _agent(num_lanes=2, rows_per_lane=2, output=(0.75, 0.0))
    _act(agent)
    at_goal = np.array([[3.0, 0.0]] * 4)
    agent.intrinsic_reward(at_goal)
    agent.start(np.array([1]))
    assert agent.goals_reached.tolist() == [1, 1, 0, 0]
    _act(agent)
    agent.intrinsic_reward(at_goal)
    assert agent.goals_reached.tolist() == [1, 1, 1, 1]


def test_a_controller_output_turns_the_goal_with_the_robot():
    # The eight outputs say nothing but the fourth: straight ahead of the robot, 0.5 * 4 m.
    output = (-0.9, -0.9, -0.9, 0.5, -0.9, -0.9, -0.9, -0.9)
    agent = _agent(controller=MLP(OBSERVED, (), 8), controller_output=OneHotOutput(), output=output, sees=np.zeros(16))
    _act(agent, position=(1, 1), heading=math.pi / 2)
    assert agent.goal[0] == pytest.approx([1, 3], abs=1e-6)


def test_a_primitive_sees_the_part_of_the_observation_that_is_its_view():
    # Columns 1 and 0, in this order: not a slice.
    agent = _agent(output=(0.5, 0), primitive_view=ColumnsView((1, 0)))
    agent.is_recording = True
    _act(agent, observation=(7, -8))
    assert agent.moments[PRIMITIVE].total[0] == pytest.approx([0, 1, 0.002, -8, 7], abs=1e-6)
    assert agent.moments[CONTROLLER].total[0].tolist() == [7, -8]


def test_controls_are_the_primitives_outputs_times_the_limit():
    unit, ant = (_act(_agent(control_limit=limit), position=(0.5, 0)) for limit in (1.0, 30.0))
    assert ant == pytest.approx(30 * unit, rel=1e-6)
    assert np.abs(unit).max() > 0.1


def test_decision_noise_is_added_to_the_tanh_output_and_moves_the_goal_fourfold():
    agent = _agent(output=(0.5, -0.5))
    noise = np.array([[[0.01, -0.02]]], np.float32)
    _act(agent, decision_noise=noise)
    assert agent.goal[0] == pytest.approx([2.04, -2.08], abs=1e-5)
    goal = agent.goal.copy()
    for _ in range(INTERVAL - 1):
        _act(agent, decision_noise=7 * noise)  # no decision is due: not used
        assert np.array_equal(agent.goal, goal)


def test_control_noise_is_added_to_the_control_not_scaled_by_its_limit():
    clean, noisy = (
        _act(_agent(control_limit=30.0), control_noise=noise)
        for noise in (None, np.array([[[0.5, 0, -0.25]]], np.float32))
    )
    assert noisy - clean == pytest.approx(np.array([[0.5, 0, -0.25]]), abs=1e-5)


def test_observations_are_normalised_by_each_levels_own_statistics():
    agent = _agent(output=(0, 0), follows=1.0)
    controller, primitive = agent.theta[CONTROLLER][0], agent.theta[PRIMITIVE][0]
    agent.normalise_by(
        (
            LevelParameters(theta=controller, mean=np.array([10.0, 0.0]), inverse_std=np.array([0.5, 1.0])),
            LevelParameters(
                theta=primitive, mean=np.array([0, 2.0, 0, 0, 0]), inverse_std=np.array([1, 0.25, 1, 1, 1])
            ),
        )
    )
    control = _act(agent, observation=(10.5, 100))
    vector = np.array([4 * math.tanh(0.25), 4 * math.tanh(5)])  # 100 is clipped to 5 deviations
    assert agent.goal[0] == pytest.approx(vector, abs=1e-5)
    angle = math.atan2(vector[1], vector[0])
    features = [math.sin(angle), (math.cos(angle) - 2) / 4, math.hypot(*vector)]
    assert control[0] == pytest.approx(np.tanh(features), abs=1e-5)


def test_parameters_are_frozen_with_the_normalisation_of_their_statistics():
    statistics = ObservationStatistics.empty(2).merge(4, np.array([8.0, 0.0]), np.array([32.0, 0.0]))
    level = LevelParameters.of(np.ones(3, np.float32), statistics)
    assert level.mean.tolist() == [2, 0]
    assert level.inverse_std == pytest.approx([1 / 2, 10])  # variance 8 - 4; the floor of 0.01


def test_each_pair_keeps_its_own_clock():
    agent = _agent(num_lanes=3, rows_per_lane=2)
    history = []
    for step in range(9):
        if step in (1, 6):
            agent.start(np.array([1]))
        _act(agent, position=(step, 0))
        history.append(agent.goal[:, 0].round(4).tolist())
    # Pairs 0 and 2 decide at 0, 4, 8; pair 1, started anew at 1 and at 6, at 0, 1, 5, 6.
    assert [row[0] - 2 for row in history] == [0] * 4 + [4] * 4 + [8]
    assert [row[2] - 2 for row in history] == [0] + [1] * 4 + [5] + [6] * 3
    assert [row[4] for row in history] == [row[0] for row in history]
    assert all(row[0] == row[1] and row[2] == row[3] for row in history)


@pytest.mark.parametrize("episodes", [1, 3])
@pytest.mark.parametrize("hidden", [(8,), (64, 64)])
def test_the_bits_of_a_pair_do_not_depend_on_who_else_decides_with_it(hidden, episodes):
    design = _design(controller=MLP(OBSERVED, hidden, 2), primitive=MLP(3 + OBSERVED, hidden, 3))
    rng = np.random.default_rng(0)
    steps = 3 * INTERVAL
    thetas = [[mlp.initial(rng, "glorot_normal") for mlp in design.policies] for _ in range(4)]
    seen = rng.normal(size=(steps, 4, episodes, OBSERVED + 3))  # observation, position, heading

    def play(members, delays):
        """Return the controls of each member, started after its delay."""
        agent = design.make(len(members), episodes)
        agent.normalise_by(
            tuple(
                LevelParameters.of(theta, ObservationStatistics.empty(size))
                for theta, size in zip(thetas[0], design.observation_sizes, strict=True)
            )
        )
        for place, member in enumerate(members):
            for level in (0, 1):
                agent.theta[level][place] = thetas[member][level]
        controls = {member: [] for member in members}
        for step in range(steps):
            inputs = np.zeros((len(members), episodes, OBSERVED + 3))
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if step == delay:
                    agent.start(np.array([place]))
                if step >= delay:
                    inputs[place] = seen[step - delay, member]
            rows = inputs.reshape(-1, OBSERVED + 3)
            out = agent.act(rows[:, :2].copy(), rows[:, 2:4].copy(), rows[:, 4].copy())
            for place, (member, delay) in enumerate(zip(members, delays, strict=True)):
                if step >= delay:
                    controls[member].append(out.reshape(len(members), -1)[place].tobytes())
        return controls

    alone = {member: play([member], [0])[member] for member in range(4)}
    for members, delays in (([0, 1, 2, 3], [0, 0, 0, 0]), ([3, 1, 0], [0, 2, 5]), ([2, 0, 1, 3], [1, 1, 3, 0])):
        for member, controls in play(members, delays).items():
            assert controls == alone[member][: len(controls)]
            assert len(controls) > INTERVAL


def test_nothing_is_recorded_unless_asked_for():
    agent = _agent()
    for _ in range(INTERVAL + 1):
        _act(agent, observation=(1, 1))
    assert agent.moments[CONTROLLER].count.tolist() == [0]
    assert agent.moments[PRIMITIVE].count.tolist() == [0]


def test_the_primitive_is_recorded_at_every_step_and_the_controller_when_it_decides():
    agent = _agent(num_lanes=2)
    agent.is_recording = True
    for step in range(2 * INTERVAL + 1):
        if step == 5:
            agent.start(np.array([1]))  # forgets what the lane's last episodes saw
        _act(agent, observation=(step, 1))
    assert agent.moments[PRIMITIVE].count.tolist() == [9, 4]
    assert agent.moments[CONTROLLER].count.tolist() == [3, 1]
    assert agent.moments[CONTROLLER].total.tolist() == [[0 + 4 + 8, 3], [5, 1]]
    assert agent.moments[CONTROLLER].total_squares.tolist() == [[16 + 64, 3], [25, 1]]
    assert agent.moments[PRIMITIVE].total[:, 3].tolist() == [36, 5 + 6 + 7 + 8]


def test_counts_of_moments_are_64_bit():
    moments = Moments.zeros(2, 1)
    moments.count[:] = 2**40
    moments.add(np.array([1]), np.array([[1.0]]))
    assert moments.count.tolist() == [2**40, 2**40 + 1]


def test_the_design_knows_its_sizes():
    design = _design(controller=MLP(7, (4,), 2), primitive=MLP(10, (5,), 8))
    assert design.dims == (7 * 4 + 4 + 4 * 2 + 2, 10 * 5 + 5 + 5 * 8 + 8)
    assert design.observation_sizes == (7, 10)
    assert (design.decision_size, design.controller_interval, design.intrinsic_level) == (2, INTERVAL, PRIMITIVE)


@pytest.mark.parametrize("change", ["mirror", "turn"])
def test_an_equivariant_controller_answers_a_changed_world_with_a_changed_goal(change):
    """Normalisation included. The heading stays as it is, so a controller that sees it answers mirrored worlds only."""
    equivariant = {"controller_network": "equivariant", "controller_view": "sectors", "minimum_goal_distance": False}
    config = make_config("point-gather", "smoke", {**equivariant, "controller_output": "heading_direction"})
    design, rng = build_algorithm(config).design, np.random.default_rng(5)
    network, view = design.controller, design.controller_view
    theta = rng.normal(0, 0.5, network.num_params).astype(np.float32)
    if change == "turn":
        of_heading = network.index[: network.sizes[0] * network.sizes[1]].reshape(7, 10, -1)[4]
        theta[np.unique(of_heading)] = 0
    total, squares = rng.uniform(0, 9, 70), rng.uniform(40, 60, 70)
    network.pool(total, squares)
    statistics = ObservationStatistics(count=20, total=total, total_squares=squares)
    primitive = design.policies[1]
    unseen = ObservationStatistics.empty(primitive.sizes[0])
    levels = (LevelParameters.of(theta, statistics), LevelParameters.of(primitive.initial(rng), unseen))

    def goals(observation, position):
        agent = design.make(1, len(observation))
        agent.normalise_by(levels)
        agent.theta[0][0], agent.theta[1][0] = (level.theta for level in levels)
        agent.start(slice(None))
        agent.act(observation, position, np.zeros(len(observation)))
        return agent.goal - position

    observation = rng.uniform(0, 1, (6, 25))
    angle = np.pi / 5
    matrix = (
        [[1, 0], [0, -1]] if change == "mirror" else [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    )
    rings, changed = np.array(view.rings), observation.copy()
    changed[:, rings] = observation[:, rings[:, ::-1] if change == "mirror" else np.roll(rings, 1, axis=1)]
    for columns in view.vectors.values():
        changed[:, columns] = observation[:, columns] @ np.transpose(matrix)
    plain, answer = (goals(each, each[:, view.vectors["position"]]) for each in (observation, changed))
    np.testing.assert_allclose(np.hypot(*plain.T), 4.0, rtol=1e-6)
    np.testing.assert_allclose(answer, plain @ np.transpose(matrix), atol=1e-4)
    assert np.abs(answer - plain).max() > 0.5
