"""Worlds: the boxes of a grid cover each of its wall cells once, and no other cell."""

import mujoco
from hypothesis import given
from hypothesis import strategies as st

from shes.envs.worlds import ARENA, CELL_SIZE_M, add_grid, empty_world, merged_boxes

INNER_WALLS = (
    "#######",
    "#..#..#",
    "#.##r.#",
    "#.....#",
    "###.#.#",
    "#...#.#",
    "#######",
)


def cell_centres(grid):
    """Yield (cell, x, y) with the robot's cell at the origin."""
    ((row, column),) = [(i, j) for i, line in enumerate(grid) for j, cell in enumerate(line) if cell == "r"]
    for i, line in enumerate(grid):
        for j, cell in enumerate(line):
            yield cell, 8.0 * (j - column), 8.0 * (i - row)


def assert_boxes_are_the_walls(grid, boxes):
    area = sum(4 * half_width * half_depth for _, _, half_width, half_depth in boxes)
    assert area == 64 * sum(row.count("#") for row in grid)
    for cell, x, y in cell_centres(grid):
        # Nine points of the cell: each lies in one box (so boxes do not overlap) or, in a free cell, in none.
        for dx in (-3.9, 0, 3.9):
            for dy in (-3.9, 0, 3.9):
                inside = sum(abs(x + dx - bx) < hx and abs(y + dy - by) < hy for bx, by, hx, hy in boxes)
                assert inside == (cell == "#"), (cell, x + dx, y + dy)


@given(st.data())
def test_boxes_cover_exactly_the_wall_cells_of_any_grid(data):
    rows, columns = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 6))
    cells = data.draw(st.lists(st.sampled_from("#."), min_size=rows * columns, max_size=rows * columns))
    cells[data.draw(st.integers(0, rows * columns - 1))] = "r"
    grid = tuple("".join(cells[i * columns : (i + 1) * columns]) for i in range(rows))
    assert_boxes_are_the_walls(grid, merged_boxes(grid, "#"))


def test_the_walls_of_gather_are_four_boxes_12_m_from_the_origin():
    boxes = merged_boxes(ARENA, "#")
    assert sorted(boxes) == [(-16, 0, 4, 12), (0, -16, 20, 4), (0, 16, 20, 4), (16, 0, 4, 12)]


def test_rows_and_columns_are_y_and_x_and_the_first_row_is_the_lowest():
    assert merged_boxes(("r.#",), "#") == [(16, 0, 4, 4)]
    assert merged_boxes(("r", ".", "#"), "#") == [(0, 16, 4, 4)]
    assert merged_boxes(("#", "r"), "#") == [(0, -8, 4, 4)]


def test_walls_become_static_boxes_4_m_high_that_take_contacts():
    spec = empty_world("world", "euler")
    add_grid(spec, INNER_WALLS)
    model = spec.compile()
    boxes = merged_boxes(INNER_WALLS, "#")
    walls = [model.geom(f"wall_{number}") for number in range(len(boxes))]
    assert model.ngeom == 1 + len(boxes)
    for wall, (x, y, half_width, half_depth) in zip(walls, boxes, strict=True):
        assert wall.type[0] == mujoco.mjtGeom.mjGEOM_BOX
        assert wall.bodyid[0] == 0
        assert wall.pos.tolist() == [x, y, 2]
        assert wall.size.tolist() == [half_width, half_depth, 2]
        assert wall.conaffinity[0] == 1


def test_the_floor_lies_under_the_whole_world():
    model = empty_world("world", "euler").compile()
    floor = model.geom("floor")
    assert floor.type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    assert floor.pos.tolist() == [0, 0, 0]
    assert floor.size.min() >= 4 * CELL_SIZE_M
    assert floor.conaffinity[0] == 1
