"""Gather by hand: pickups, readings and scores of a robot that the test places. The rest is in the reference."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.markers import POISON as POISON_COLOR
from tests.envs.episodes import make_task


def start(name="point-gather", food=(), poison=(), spec="shes"):
    """Return one episode, at rest at the origin, with the given objects; the others are far away."""
    task = make_task(name, 1, reset_noise=0, spec=spec)
    task.reset(np.arange(1), [0])
    put(task, food, poison)
    return task


def put(task, food=(), poison=()):
    """Place the objects of episode 0."""
    task.objects[0] = 1000.0
    for kind, places in enumerate((food, poison)):
        for number, place in enumerate(places):
            task.objects[0, kind, number] = place
    task.present[0] = True


def step(task):
    task.step(np.arange(1), np.zeros((1, task.action_size)))
    return float(task.reward[0])


def test_an_object_nearer_than_1_m_is_caught_once():
    task = start(food=[(1.0, 0), (0, -1.0), (0.9999, 0), (0, -0.9999), (0.71, 0.71)], poison=[(0, 0.5)])
    assert [step(task) for _ in range(3)] == [1, 0, 0]
    assert_array_equal(task.present[0, 0, :5], [True, True, False, False, True])
    assert (task.counts["food"][0], task.counts["poison"][0], task.running_return[0]) == (2, 1, 1)
    task.reset(np.arange(1), [0])
    assert (task.counts["food"][0], task.counts["poison"][0], task.score[0]) == (0, 0, 0)


@pytest.mark.parametrize("kind", [0, 1])
def test_an_object_shows_in_the_bin_of_its_bearing(kind):
    """At the borders of bins and of the range, which the random states of the reference miss."""
    # Straight ahead is the border of the two front bins and belongs to the left one; bin 0 begins at bearing -pi.
    bins = {(4, 0): 5, (4, -0.1): 4, (-4, 0): 0, (-4, -0.1): 0, (-4, 0.1): 9, (0, 4): 7, (0, -4): 2}
    for place, number in bins.items():
        task = start(**{("food", "poison")[kind]: [place]})
        step(task)
        seen = task.observe()[0, task.sensor_rings]
        expected = (1 - (place[0] ** 2 + place[1] ** 2) / 64) * (np.arange(10) == number)
        np.testing.assert_allclose(seen[kind], expected, atol=1e-15, err_msg=str(place))
        assert not seen[1 - kind].any()


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_sensor_markers_show_distance_and_sector(spec):
    place = 4 * np.array([np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40))])
    task = start("ant-gather", poison=[place], spec=spec)
    task.sim.qpos[0, 3:7] = [np.cos(np.deg2rad(15)), 0, 0, np.sin(np.deg2rad(15))]  # bin 5 is 30 to 66 degrees
    step(task)
    ray, *arc = task.sensor_markers(0)
    robot, heading = task.position[0], np.rad2deg(task.heading[0])
    assert ray.position[:2] == tuple(robot)
    ends = np.array([arc[0].position, *(line.end for line in arc)])[:, :2] - robot
    np.testing.assert_allclose(np.hypot(*ends.T), np.hypot(*(place - robot)), rtol=1e-9)
    bearings = np.rad2deg(np.arctan2(ends[:, 1], ends[:, 0])) - heading
    np.testing.assert_allclose(bearings, np.linspace(0, 36, 7), atol=1e-9)
    assert {marker.color[:3] for marker in (ray, *arc)} == {POISON_COLOR[:3]}
    put(task)
    step(task)
    assert task.sensor_markers(0) == make_task("point-push", 1).sensor_markers(0) == []


def test_a_divergence_takes_the_score_and_collects_nothing():
    # MuJoCo's own reset puts the robot back to the origin, where food is waiting.
    task = start(food=[(0.5, 0)] * 3)
    step(task)
    assert task.score[0] == 3
    put(task, food=[(0, 0.5)] * 4)
    task.sim.qvel[0, 0] = 1e12
    for _ in range(3):
        assert step(task) == 0
        assert (task.score[0], task.counts["food"][0], task.running_return[0], task.success[0]) == (0, 0, 3, False)


@pytest.mark.parametrize(
    ("spec", "height", "is_cleared", "reward", "has_ended", "has_fallen"),
    [
        ("shes", 0.5, False, 1, False, False),
        ("shes", 1.5, False, 1, True, True),  # the step of a fall still pays its pickups
        ("shes", 0.5, True, 0, False, False),
        ("hiro", 1.5, False, -10, True, True),
        ("hiro", 0.5, True, 0, True, False),  # an arena that is cleared ends the episode without a fall
        ("hiro", 1.5, True, -10, True, True),
    ],
)
def test_a_fall_and_a_cleared_arena(spec, height, is_cleared, reward, has_ended, has_fallen):
    task = start("ant-gather", food=[(0.5, 0)], spec=spec)
    task.present[0] = not is_cleared
    task.sim.qpos[0, 2] = height
    assert step(task) == reward
    assert (task.terminated[0], task.fallen[0]) == (has_ended, has_fallen)
