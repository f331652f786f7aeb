"""Worlds: the boxes of a grid cover each of its wall cells once, and no other cell."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.envs.worlds import ARENA, merged_boxes


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


@pytest.mark.parametrize(
    ("grid", "boxes"),
    [
        (ARENA, [(-16, 0, 4, 12), (0, -16, 20, 4), (0, 16, 20, 4), (16, 0, 4, 12)]),
        (("r.#",), [(16, 0, 4, 4)]),  # columns are x
        (("r", ".", "#"), [(0, 16, 4, 4)]),  # rows are y
        (("#", "r"), [(0, -8, 4, 4)]),  # the first row is the lowest
    ],
)
def test_walls_are_merged_into_few_boxes_around_the_robot(grid, boxes):
    assert sorted(merged_boxes(grid, "#")) == boxes
