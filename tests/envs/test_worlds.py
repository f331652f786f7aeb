"""Worlds: the boxes of a grid cover each of its wall cells once, and no other cell."""

from hypothesis import given
from hypothesis import strategies as st

from shes.envs.worlds import merged_boxes


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
