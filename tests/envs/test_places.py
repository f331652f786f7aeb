"""Boxes of a world; places of a search in Maze, Push and Fall, and the way that the reward then follows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.envs.worlds import merged_boxes
from tests.envs.episodes import make_task

STANDING, LYING = (1, 0, 0, 0), (0, 1, 0, 0)


def state(task, place, block=()):
    """Return the physics state of a robot at `place`, and of a block moved by `block`."""
    found = task.states(np.array([0]))[0]
    found[: len(place)] = place
    found[task.body.num_qpos : task.body.num_qpos + len(block)] = block
    return found


@pytest.mark.parametrize(
    ("name", "place", "block", "cell"),
    [
        ("point-maze", (2.4, -1.6), (), (2, -2)),
        ("ant-maze", (2.6, -1.4), (), (3, -1)),
        ("ant-push", (-0.4, 3.6), (-2.9, 5.1), (0, 4, -1, 3)),
        ("ant-fall", (8.2, 11.7, 4.9), (6.9, -3.9), (8, 12, 2, 3, -2)),
        ("ant-fall", (8.2, 11.7, 0.75), (0, 0), (8, 12, 0, 0, 0)),
    ],
)
def test_a_cell_is_the_place_and_height_of_robot_and_block(name, place, block, cell):
    task = make_task(name, 1)
    places = task.places(state(task, place, block)[None])
    assert places.cells.tolist() == [list(cell)]
    assert places.positions.tolist() == [[*place, *(block if "fall" in name else ())]]


@pytest.mark.parametrize("height", [0.75, 0.1])
@pytest.mark.parametrize("quaternion", [STANDING, LYING])
def test_upright_is_by_the_rule_of_the_body_and_its_tilt(height, quaternion):
    task = make_task("ant-maze", 1)
    found = task.places(state(task, (0, 0, height, *quaternion))[None]).is_upright
    assert found.tolist() == [height == 0.75 and quaternion == STANDING]


@pytest.mark.parametrize("name", ["point-maze", "ant-maze"])
def test_success_is_measured_to_the_target(name):
    task = make_task(name, 1)
    states = np.stack([state(task, (0, y)) for y in (10.9, 11.1, 16.0, 21.1)])
    assert task.places(states).is_success.tolist() == [False, True, True, False]
    elsewhere = make_task(name, 1, target=(9.0, 3.0))
    assert elsewhere.places(state(task, (9, 3))[None]).is_success.tolist() == [True]
    fall = make_task("ant-fall", 1)  # its target has a height
    assert fall.places(np.stack([state(fall, (0, 24, z)) for z in (4.75, 0.4)])).is_success.tolist() == [True, False]


def test_a_way_gives_the_reward_until_it_is_taken_back():
    task = make_task("point-maze", 1, target=(6.0, 8.0), reset_noise=0.0)
    rewards = []
    for way in (None, np.array([[6.0, 0.0], [6.0, 4.0]]), np.array([[0.0, 8.0]]), None):
        task.set_way(way)
        task.reset(np.array([0]), [1])
        for place in ((0, 0), (0, 1)):
            task.sim.qpos[0, :2] = place
            rewards += task.update_features().tolist()
    assert rewards == pytest.approx([-10, -np.hypot(6, 7), 0, 6 - np.hypot(6, 1), 0, 1, -10, -np.hypot(6, 7)])
    task.set_way(np.array([[0.1, 0], [0.2, 0], [0.3, 0], [6, 0]]))
    task.reset(np.array([0]), [1])
    for _ in range(4):
        task.update_features()
    task.set_way(np.array([[6.0, 0]]))  # shorter, and the simulation is not reset
    assert task.update_features().tolist() == [0]


def test_a_way_leads_the_block_of_fall_too():
    task, rewards = make_task("point-fall", 1, reset_noise=0.0), []
    task.scale = 2.0  # the unit of the block's coordinates, as with a robot from a file
    task.set_way(np.array([[0.0, 0, 4, 0, 0], [0, 0, 4, 8, 0]]))
    for block, later in ((0, 8), (16, 16)):
        task.reset(np.array([0]), [1], [state(task, (0, 0, 4), (block, 0))])
        for place in ((0, 0, 4, block), (0, 1, 4, later)):
            task.sim.qpos[0, :4] = place
            rewards += task.update_features().tolist()
    assert rewards == pytest.approx([0, 8 - np.hypot(1, 4), 0, np.hypot(27, 0.5) - np.hypot(26, 0.5)])


@given(st.data())
def test_boxes_cover_exactly_the_wall_cells_of_any_grid(data):
    rows, columns = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 6))
    cells = data.draw(st.lists(st.sampled_from("#."), min_size=rows * columns, max_size=rows * columns))
    robot = data.draw(st.integers(0, rows * columns - 1))
    cells[robot] = "r"
    boxes = merged_boxes(tuple("".join(cells[i * columns : (i + 1) * columns]) for i in range(rows)), "#")
    assert sum(4 * half_width * half_depth for _, _, half_width, half_depth in boxes) == 64 * cells.count("#")
    for number, cell in enumerate(cells):
        x, y = 8.0 * (number % columns - robot % columns), 8.0 * (number // columns - robot // columns)
        # Nine points of the cell: each lies in one box (so boxes do not overlap) or, in a free cell, in none.
        for dx, dy in ((dx, dy) for dx in (-3.9, 0, 3.9) for dy in (-3.9, 0, 3.9)):
            inside = sum(abs(x + dx - bx) < hx and abs(y + dy - by) < hy for bx, by, hx, hy in boxes)
            assert inside == (cell == "#"), (cell, x + dx, y + dy)
