"""The rules of Gather, on a point that the test places."""

import numpy as np
import pytest
import scipy.stats
from numpy.testing import assert_array_equal

from shes.envs.markers import POISON as POISON_COLOR
from shes.envs.registry import make_task
from shes.envs.tasks.task_options import TaskOptions

FAR_AWAY = 1000.0
FOOD, POISON = slice(0, 10), slice(10, 20)
REST = np.zeros((1, 2))


def start(name="point-gather", food=(), poison=(), spec="shes"):
    """Return one episode, at rest at the origin, with the given objects; the others are far away."""
    task = make_task(name, 1, TaskOptions(reset_noise=0, spec=spec))
    task.reset(np.arange(1), [0])
    put(task, food, poison)
    return task


def put(task, food=(), poison=()):
    """Place the objects of episode 0."""
    task.objects[0] = FAR_AWAY
    for kind, places in enumerate((food, poison)):
        for number, place in enumerate(places):
            task.objects[0, kind, number] = place
    task.present[0] = True


def step(task, action=None):
    task.step(np.arange(1), np.zeros((1, task.action_size)) if action is None else action)
    return float(task.reward[0])


def readings(task):
    """Return the readings [20] after a step at rest."""
    step(task)
    robot = task.body.num_qpos + task.body.num_qvel
    return task.observe()[0, robot : robot + 20].copy()


def only(bin_number, value):
    expected = np.zeros(10)
    expected[bin_number] = value
    return expected


# --- Where objects lie -----------------------------------------------------------------------------------------------


def test_eight_pieces_of_food_and_eight_of_poison():
    task = make_task("point-gather", 3)
    task.reset(np.arange(3), [0, 1, 2])
    assert task.objects.shape == (3, 2, 8, 2)
    assert task.present.all()
    assert not task.food.any()
    assert not task.poison.any()


@pytest.fixture(scope="module")
def many_objects():
    """Positions [1500, kind, object, xy] of the objects of 1500 episodes."""
    task = make_task("point-gather", 1500)
    task.reset(np.arange(1500), range(1500))
    return task.objects.copy()


def test_objects_lie_in_the_square_and_not_near_the_origin(many_objects):
    assert np.abs(many_objects).max() <= 10
    assert np.abs(many_objects).max() > 9.99
    radius = np.hypot(many_objects[..., 0], many_objects[..., 1])
    assert radius.min() >= 2
    assert radius.min() < 2.05


@pytest.mark.parametrize("kind", [0, 1])
def test_objects_are_uniform_over_the_square_outside_the_free_radius(many_objects, kind):
    places = many_objects[:, kind].reshape(-1, 2)
    edges = np.linspace(-10, 10, 11)
    counted = np.histogram2d(places[:, 0], places[:, 1], bins=[edges, edges])[0]
    area = np.full((10, 10), 4.0)
    area[4:6, 4:6] = 4 - np.pi  # a quarter of the free disc lies in each of the four cells around the origin
    expected = area / area.sum() * len(places)
    assert scipy.stats.chisquare(counted.ravel(), expected.ravel()).pvalue > 1e-3


@pytest.mark.parametrize("number", [0, 3, 7])
def test_the_place_of_an_object_does_not_depend_on_its_number(many_objects, number):
    places = many_objects[:, :, number].reshape(-1, 2)
    # Mean and variance of x on the square less the disc: E x^2 = (400 * 100 / 3 - 4 pi) / (400 - 4 pi).
    variance = (400 * 100 / 3 - 4 * np.pi) / (400 - 4 * np.pi)
    error = np.sqrt(variance / len(places))
    assert np.abs(places.mean(axis=0)).max() < 4 * error
    np.testing.assert_allclose(places.var(axis=0), variance, rtol=0.08)


def test_no_two_objects_of_all_episodes_share_a_place(many_objects):
    places = many_objects.reshape(-1, 2)
    assert len(np.unique(places, axis=0)) == len(places)


def test_objects_come_from_the_seed_alone():
    task = make_task("point-gather", 2)
    task.reset(np.arange(2), [5, 6])
    first = task.objects.copy()
    task.reset(np.arange(2), [6, 5])
    assert_array_equal(task.objects, first[::-1])
    ant = make_task("ant-gather", 1)
    ant.reset(np.arange(1), [7])
    assert not (ant.objects[0] == first[0]).any()


def test_a_reset_brings_every_object_back():
    task = start(food=[(0.5, 0), (0, 0.5)], poison=[(-0.5, 0)])
    step(task)
    assert (task.food[0], task.poison[0]) == (2, 1)
    task.reset(np.arange(1), [0])
    assert (task.food[0], task.poison[0], task.score[0]) == (0, 0, 0)
    assert task.present.all()


# --- Catching --------------------------------------------------------------------------------------------------------


def test_an_object_is_caught_when_nearer_than_1_m():
    task = start(food=[(1.0, 0), (0, -1.0), (0.9999, 0), (0, -0.9999), (0.71, 0.71)])
    assert step(task) == 2
    assert_array_equal(task.present[0, 0, :5], [True, True, False, False, True])


def test_food_pays_1_and_poison_costs_1():
    assert step(start(food=[(0.5, 0)])) == 1
    assert step(start(poison=[(0.5, 0)])) == -1
    assert step(start(food=[(0.5, 0), (0, 0), (0, 0.9)], poison=[(0.5, 0.5)])) == 2


def test_an_object_is_caught_once():
    task = start(food=[(0.5, 0)], poison=[(0, 0.5)] * 2)
    assert [step(task) for _ in range(3)] == [-1, 0, 0]
    assert (task.food[0], task.poison[0], task.running_return[0]) == (1, 2, -1)


def test_collecting_everything_does_not_end_the_episode():
    task = start(food=[(0.5, 0)] * 8, poison=[(0, 0.5)] * 8)
    assert step(task) == 0
    assert (task.food[0], task.poison[0]) == (8, 8)
    for _ in range(5):
        assert step(task) == 0
        assert not task.terminated[0]
    assert not readings(task).any()


def test_an_object_is_caught_where_the_robot_stands_after_the_step():
    task = start(food=[(1.5, 0)])
    task.sim.qvel[0, 0] = 7.5
    rewards = [step(task, np.array([[1.0, 0.0]])) for _ in range(6)]
    assert sum(rewards) == 1
    first = rewards.index(1)
    assert first > 0 or task.position[0, 0] > 0.5
    again = start()
    again.sim.qvel[0, 0] = 7.5
    places = []
    for _ in range(6):
        step(again, np.array([[1.0, 0.0]]))
        places.append(again.position[0, 0])
    assert first == int(np.argmax(np.abs(np.array(places) - 1.5) < 1))


# --- Readings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "bin_number"),
    [
        ((4, 0), 5),  # straight ahead: the border of the two front bins belongs to the left one
        ((4, -0.1), 4),
        ((-4, 0), 0),  # behind: bin 0 begins at bearing -pi
        ((-4, -0.1), 0),
        ((-4, 0.1), 9),
        ((0, 4), 7),  # left
        ((0, -4), 2),  # right
    ],
)
@pytest.mark.parametrize("kind", ["food", "poison"])
def test_an_object_shows_in_the_bin_of_its_bearing(place, bin_number, kind):
    seen = readings(start(**{kind: [place]}))
    mine, other = (FOOD, POISON) if kind == "food" else (POISON, FOOD)
    np.testing.assert_allclose(seen[mine], only(bin_number, 1 - (place[0] ** 2 + place[1] ** 2) / 64), atol=1e-15)
    assert not seen[other].any()


def test_each_bin_covers_a_tenth_of_the_circle():
    bearings = -np.pi + (np.arange(10) + 0.5) * 2 * np.pi / 10
    for number, bearing in enumerate(bearings):
        for shift in (-0.31, 0, 0.31):  # a bin is 0.628 rad wide
            place = 4 * np.array([np.cos(bearing + shift), np.sin(bearing + shift)])
            assert_array_equal(np.flatnonzero(readings(start(food=[place]))), [number])


@pytest.mark.parametrize(
    ("distance", "intensity"), [(1, 63 / 64), (2, 15 / 16), (4, 3 / 4), (7, 15 / 64), (8, 0), (8.001, 0), (14, 0)]
)
def test_the_reading_falls_with_the_square_of_the_distance_to_0_at_8_m(distance, intensity):
    assert_array_equal(readings(start(food=[(0, distance)]))[FOOD], only(7, intensity))


def test_an_object_where_the_robot_stands_is_caught_and_no_longer_read():
    task = start(food=[(0, 0)], poison=[(0, 0)])
    assert not readings(task).any()
    assert (task.food[0], task.poison[0]) == (1, 1)


def test_readings_are_taken_after_the_pickups():
    task = start(food=[(0, 0.9), (0, 4)])
    assert_array_equal(readings(task)[FOOD], only(7, 0.75))
    assert task.food[0] == 1


def test_the_nearest_object_of_a_kind_wins_its_bin():
    for food in ([(0, 2), (0, 4), (0, 6)], [(0, 6), (0, 4), (0, 2)], [(0, 4), (0, 2), (0, 6)]):
        seen = readings(start(food=food, poison=[(0, 6), (0, 4)]))
        assert_array_equal(seen[FOOD], only(7, 15 / 16))
        assert_array_equal(seen[POISON], only(7, 0.75))


def test_readings_turn_with_the_ant():
    # Ahead-left by 18 degrees: the middle of bin 5. After a turn by 90 degrees to the left it stands at -72 degrees,
    # the middle of bin 3; after one to the right at 108 degrees, the middle of bin 8.
    place = 4 * np.array([np.cos(np.deg2rad(18)), np.sin(np.deg2rad(18))])
    for turn, bin_number in ((0, 5), (90, 3), (-90, 8), (180, 0), (-180, 0)):
        task = start("ant-gather", food=[place])
        task.sim.qpos[0, 3:7] = [np.cos(np.deg2rad(turn / 2)), 0, 0, np.sin(np.deg2rad(turn / 2))]
        np.testing.assert_allclose(readings(task)[FOOD], only(bin_number, 0.75), atol=0.02)


def test_readings_move_with_the_robot():
    task = start(food=[(4, 4)])
    task.sim.qpos[0] = [4, 0]
    assert_array_equal(readings(task)[FOOD], only(7, 0.75))
    task.sim.qpos[0] = [8, 4]
    assert_array_equal(readings(task)[FOOD], only(0, 0.75))


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_the_markers_of_the_sensors_are_at_the_distance_and_in_the_sector_of_the_object(spec):
    task = make_task("ant-gather", 1, TaskOptions(reset_noise=0, spec=spec))
    task.reset(np.arange(1), [0])
    place = 4 * np.array([np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40))])
    put(task, poison=[place])
    task.sim.qpos[0, 3:7] = [np.cos(np.deg2rad(15)), 0, 0, np.sin(np.deg2rad(15))]  # by 30 degrees: bin 5 is 30 to 66
    step(task)
    ray, *arc = task.sensor_markers(0)
    robot, heading = task.position[0], np.rad2deg(task.heading[0])
    assert ray.position[:2] == tuple(robot)
    ends = np.array([arc[0].position, *(line.end for line in arc)])[:, :2] - robot
    np.testing.assert_allclose(np.hypot(*ends.T), np.hypot(*(place - robot)), rtol=1e-9)
    bearings = np.rad2deg(np.arctan2(ends[:, 1], ends[:, 0])) - heading
    np.testing.assert_allclose(bearings, np.linspace(0, 36, 7), atol=1e-9)
    assert {marker.color[:3] for marker in (ray, *arc)} == {POISON_COLOR[:3]}


def test_sensors_that_read_nothing_have_no_markers():
    task = start()
    step(task)
    assert task.sensor_markers(0) == []
    assert make_task("point-push", 1).sensor_markers(0) == []


def test_the_first_observation_reads_the_objects_of_the_reset():
    task = start()
    task.reset(np.arange(1), [3])
    robot = task.body.num_qpos + task.body.num_qvel
    seen = task.observe()[0, robot : robot + 20]
    for kind, part in enumerate((FOOD, POISON)):
        nearest = (task.objects[0, kind] ** 2).sum(axis=1).min()
        assert seen[part].max() == pytest.approx(max(1 - nearest / 64, 0))
        assert seen[part].max() > 0


# --- Time, score, end ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_time_is_observed_as_control_steps_times_a_thousandth(spec):
    task = start(spec=spec)
    column = task.observation_names.index("time")
    seen = [task.observe()[0, column]]
    for _ in range(600):
        step(task)
        seen.append(task.observe()[0, column])
    assert_array_equal(seen, np.arange(601) * 0.001)


def test_observations_have_50_values_for_the_ant_and_25_for_the_point():
    assert make_task("ant-gather", 1).observation_size == 50
    assert make_task("point-gather", 1).observation_size == 25


def test_the_score_is_the_highest_running_return_and_never_below_0():
    task = start()
    scores, returns = [], []
    for food, poison in [(0, 1), (1, 0), (2, 0), (0, 3), (1, 0), (0, 0), (4, 1), (0, 5)]:
        put(task, food=[(0.5, 0)] * food, poison=[(0, 0.5)] * poison)
        step(task)
        scores.append(task.score[0])
        returns.append(task.running_return[0])
    assert returns == [-1, 0, 2, -1, 0, 0, 3, -2]
    assert scores == [0, 0, 2, 2, 2, 2, 3, 3]


def test_success_is_a_score_above_0():
    task = start()
    for food, poison, expected in ((0, 1, False), (1, 0, False), (1, 0, True), (0, 3, True)):
        put(task, food=[(0.5, 0)] * food, poison=[(0, 0.5)] * poison)
        step(task)
        assert task.success[0] == expected


def test_a_reset_sets_the_score_back():
    task = start(food=[(0.5, 0)] * 3)
    step(task)
    assert task.score[0] == 3
    task.reset(np.arange(1), [0])
    assert task.score[0] == 0
    put(task, food=[(0.5, 0)])
    step(task)
    assert task.score[0] == 1


def test_a_divergence_takes_the_score_away_and_collects_nothing():
    # MuJoCo's own reset puts the robot back to the origin, where food is waiting.
    task = start(food=[(0.5, 0)] * 3)
    step(task)
    assert task.score[0] == 3
    put(task, food=[(0, 0.5)] * 4)
    task.sim.qvel[0, 0] = 1e12
    for _ in range(3):
        assert step(task) == 0
        assert (task.score[0], task.food[0], task.running_return[0]) == (0, 0, 3)
        assert not task.success[0]


@pytest.mark.parametrize(("height", "has_fallen"), [(0.5, False), (1.5, True)])
def test_a_fall_ends_the_episode_and_costs_nothing(height, has_fallen):
    task = start("ant-gather", food=[(0.5, 0)])
    assert step(task) == 1
    task.sim.qpos[0, 2] = height
    task.sim.qvel[0] = 0
    assert step(task) == 0
    assert bool(task.terminated[0]) == bool(task.fallen[0]) == has_fallen
    assert (task.score[0], task.running_return[0]) == (1, 1)


@pytest.mark.parametrize("height", [0.5, 1.5])
def test_an_arena_that_is_cleared_ends_the_episode_without_a_fall(height):
    task = make_task("ant-gather", 1, TaskOptions(reset_noise=0, spec="hiro"))
    task.reset(np.arange(1), [0])
    task.present[0] = False
    task.sim.qpos[0, 2] = height
    step(task)
    assert task.terminated[0]
    assert task.fallen[0] == (height == 1.5)


def test_the_step_of_a_fall_still_pays_its_pickups():
    task = start("ant-gather", food=[(0.5, 0)])
    task.sim.qpos[0, 2] = 1.5
    assert step(task) == 1
    assert task.terminated[0]


def test_the_end_is_decided_by_the_torso_height_after_the_step():
    task = make_task("ant-gather", 3, TaskOptions(reset_noise=0))
    task.reset(np.arange(3), [0, 1, 2])
    assert not task.terminated.any()
    task.sim.qpos[:, 2] = [0.19, 0.7, 1.01]
    assert_array_equal(task.terminated, [True, False, True])
