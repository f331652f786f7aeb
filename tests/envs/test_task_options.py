"""The options of a task as Python arguments: they are applied, or raise. `test_settings` tests kinds of values."""

import numpy as np
import pytest

from shes.envs.named_environments import ENVIRONMENTS
from shes.errors import ConfigError, UnknownNameError
from shes.settings import setting_fields
from tests.envs.episodes import make_task

OUTSIDE = {"controller_interval": 0, "goal_distance": 0.99, "target": (0, -1000.1), "reset_noise": 1.0}


@pytest.mark.parametrize(("option", "wrong"), OUTSIDE.items())
def test_a_value_out_of_range_is_refused_by_the_task(option, wrong):
    kinds = {each.task.Options for each in ENVIRONMENTS.values() if option in setting_fields(each.task.Options)}
    assert kinds
    for kind in kinds:
        with pytest.raises((ConfigError, UnknownNameError)):
            kind(**{option: wrong})


def test_the_reward_is_the_progress_along_the_way():
    task, both, left = make_task("point-maze", 2, target=(6.0, 8.0), reset_noise=0.0), np.arange(2), np.zeros(2)
    task.set_way(np.array([[6.0, 0.0], [6.0, 4.0]]))

    def rewards(*places):
        task.sim.qpos[:, :2] = places
        return task.update_features()

    def start(seeds, *lengths):
        task.reset(both[: len(seeds)], seeds)
        assert rewards((0, 0), (0, 0))[: len(seeds)].tolist() == [0] * len(seeds)  # nothing came before
        left[: len(seeds)] = np.subtract(lengths, 5)  # up to success, 5 m from the target

    def left_at(*places):
        left[:] -= rewards(*places)
        return (left + 5).tolist()

    start([1, 2], 14, 14)
    # The second robot stays, so that an index shared by the episodes would show.
    assert left_at((2.9, 0), (0, 0)) == pytest.approx([11.1, 14])  # 3.1 m from the first
    assert left_at((3.1, 0), (0, 0)) == pytest.approx([np.hypot(2.9, 4) + 4, 14])  # 2.9 m from it: passed
    assert left_at((0, 0), (0, 0)) == pytest.approx([np.hypot(6, 4) + 4, 14])  # and it stays so
    assert left_at((6, 1.5), (0, 0)) == pytest.approx([6.5, 14])
    assert left_at((6, 8), (0, 0)) == pytest.approx([5, 14])
    assert task.distance.tolist() == [0, 10]
    start([3], 14)
    assert left_at((0, 0), (6, 0)) == pytest.approx([14, 8])
    # Between 3 and 8 m of a waypoint it is passed where the next one is nearer.
    start([3, 4], 14, 14)
    assert left_at((13.5, 2.1), (-1, 5)) == pytest.approx([np.hypot(7.5, 1.9) + 4, np.hypot(7, 5) + 8])
    assert left_at((2, 6.1), (1, 1.9)) == pytest.approx([5, np.hypot(5, 1.9) + 8])
    # One that begins on the way begins at its nearest point.
    task.set_way(np.array([[0.0, 90.0], [0.0, 80.0], [6.0, 4.0]]))
    task.reset(both, [5, 6], [None, task.states(both)[1]])
    assert rewards((0, 0), (6, 5)).tolist() == [0, 0]
    left[:] = np.hypot(6, 4) - 1, 0
    assert left_at((0, 0), (6, 6)) == pytest.approx([np.hypot(6, 4) + 4, 5])


TILTS, TOO_FAR = np.deg2rad([0, 44, 46, 180, -46]), [False, False, True, True, True]


@pytest.mark.parametrize(("limit", "evaluation"), [(45.0, False), (45.0, True), (None, False)])
@pytest.mark.parametrize("name", ["ant-flagrun", "ant-gather", "ant-maze", "ant-push", "ant-fall"])
def test_a_tilt_beyond_the_limit_is_a_fall_in_training_alone(name, limit, evaluation):
    expected = TOO_FAR if limit and not evaluation else [False] * 5
    task = make_task(name, 5, max_tilt=limit, evaluation=evaluation)
    task.reset(np.arange(len(TILTS)), range(len(TILTS)))
    task.sim.qpos[:, 3:7] = np.stack([np.cos(TILTS / 2), 0 * TILTS, np.sin(TILTS / 2), 0 * TILTS], axis=1)
    ends_by_itself = name in ("ant-flagrun", "ant-gather")
    task.reward[:] = -7
    assert task.terminated.tolist() == task.fallen.tolist() == expected
    assert task.tilt == pytest.approx([0, 0.5613, 0.6107, 1, 0.6107], abs=1e-4)  # of a fall, which is at 60 degrees
    if not ends_by_itself:  # a robot stays where it fell
        assert task.ends_early == any(expected)
        assert task.reward_after_end.tolist() == (-7.0 * np.array(expected)).tolist()
        task.set_way(np.ones((2, len(task.own_target))))
        assert not task.reward_after_end.any()  # it makes no progress
    task.sim.qpos[:, 2] -= 0.7  # the torso lies on the floor
    assert task.terminated.tolist() == task.fallen.tolist() == [ends_by_itself or any(expected)] * len(TILTS)


@pytest.mark.parametrize(("evaluation", "reward"), [(False, -10), (True, 0)])
def test_a_tilt_costs_as_much_as_a_fall_in_hiro_training(evaluation, reward):
    task = make_task("ant-gather", 1, spec="hiro", max_tilt=45.0, evaluation=evaluation)
    task.reset(np.arange(1), [1])
    task.sim.qpos[:, 3:7] = [0, 1, 0, 0]  # on its back
    assert task.update_features().tolist() == [reward]


def test_goals_of_flagrun_reach_the_goal_distance_on_all_sides():
    task = make_task("point-flagrun", 300, goal_distance=2.0)
    task.reset(np.arange(300), range(300))
    offset = task.goal - task.position
    reach = np.array([-offset.min(axis=0), offset.max(axis=0)])
    assert ((reach > 1.8) & (reach <= 2)).all()
