"""HIRO's goals: transition, reward, candidates and coordinates, against cases worked by hand."""

import numpy as np
import pytest

from shes.algorithms.hiro.goal_space import GoalSpace, candidates, goal_transition, primitive_columns, primitive_reward
from shes.envs.registry import find_environment, make_task
from shes.errors import ConfigError


def test_a_goal_points_to_the_same_place_after_a_step():
    goal, before, after = np.array([3.0, -1.0]), np.array([10.0, 5.0]), np.array([11.0, 4.5])
    assert goal_transition(goal, before, after).tolist() == [2.0, -0.5]
    assert (after + goal_transition(goal, before, after)).tolist() == (before + goal).tolist()


def test_the_primitive_pays_the_distance_that_is_left():
    left = goal_transition(np.array([[3.0, 0.0], [1.0, 1.0]]), np.zeros((2, 2)), np.array([[0.0, 4.0], [1.0, 1.0]]))
    assert primitive_reward(left).tolist() == [-5.0, 0.0]


def test_candidates_are_the_goal_what_happened_and_eight_around_it():
    rng, limit = np.random.default_rng(3), (10.0, 0.5)
    goal, moved = np.array([[4.0, 0.1]] * 4000), np.array([[-2.0, 0.0]] * 4000)
    found = candidates(goal, moved, limit, 10, rng)
    assert found.shape == (4000, 10, 2)
    np.testing.assert_array_equal(found[:, 0], goal)
    np.testing.assert_array_equal(found[:, 1], moved)
    drawn = found[:, 2:].reshape(-1, 2)
    np.testing.assert_allclose(np.median(drawn, axis=0), [-2, 0], atol=0.1)
    # Normal with half the half range: quartiles, because values beyond the range are clipped.
    np.testing.assert_allclose(np.quantile(drawn[:, 0], [0.25, 0.75]), -2 + 5 * np.array([-0.674, 0.674]), atol=0.15)
    assert (np.abs(drawn) <= limit).all()
    assert (np.abs(drawn[:, 1]) == 0.5).any()


def test_candidates_are_clipped_to_the_range_and_as_many_as_asked_for():
    goal, moved = np.array([[4.0]]), np.array([[-20.0]])
    assert candidates(goal, moved, (10.0,), 1, np.random.default_rng(0)).tolist() == [[[4.0]]]
    assert candidates(goal, moved, (10.0,), 2, np.random.default_rng(0)).tolist() == [[[4.0], [-10.0]]]


@pytest.mark.parametrize("env", ["ant-maze", "ant-gather", "ant-push"])
def test_a_goal_of_the_ant_is_all_of_its_coordinates(env):
    task = make_task(env, 1, find_environment(env).options(spec="hiro"))
    space = GoalSpace.of(task, 10.0)
    assert space.half_range == (10, 10, 0.5, 1, 1, 1, 1, 0.5, 0.3, 0.5, 0.3, 0.5, 0.3, 0.5, 0.3)
    task.reset(np.array([0]), [1])
    coordinates = space.coordinates(task.observe(), task.position)
    np.testing.assert_array_equal(coordinates, task.sim.qpos[:, :15])


@pytest.mark.parametrize("env", ["point-maze", "point-fall"])
def test_a_goal_of_the_point_is_its_position(env):
    task = make_task(env, 1)
    space = GoalSpace.of(task, 10.0)
    assert space.half_range == (10, 10)
    task.reset(np.array([0]), [1])
    np.testing.assert_array_equal(space.coordinates(task.observe(), task.position), task.position)


def test_the_primitive_sees_the_robot_without_its_place_and_the_time():
    for env in ("ant-gather", "ant-maze"):
        task = make_task(env, 1, find_environment(env).options(spec="hiro"))
        names = [task.observation_names[i] for i in primitive_columns(task)]
        assert names == [*(each.name for each in (*task.robot.pose[2:], *task.robot.velocity)), "time"]
        assert len(names) == 28  # 30 in HIRO, where x and y are zero


def test_a_robot_whose_position_is_unknown_has_no_goals():
    task = find_environment("gymnasium:Pendulum-v1").make(1)
    task.reset(np.array([0]), [0])
    with pytest.raises(ConfigError, match=r"the position of the robot of .* is unknown"):
        GoalSpace.of(task, 1.0)


@pytest.mark.extras  # Gymnasium's MuJoCo environments need imageio
def test_a_goal_of_an_external_robot_is_its_position_where_that_is_known():
    task = find_environment("gymnasium:Ant-v5").make(1)
    task.reset(np.array([0]), [0])
    space = GoalSpace.of(task, 2.0)
    assert (space.half_range, space.columns) == ((2.0, 2.0), None)
    position = np.array([[3.0, 4.0]])
    assert space.coordinates(task.observe(), position).tolist() == position.tolist()
