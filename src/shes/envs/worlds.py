"""Worlds: a grid of cells becomes static boxes in a MuJoCo model. Source: environment specification, Worlds.

`#` wall, `.` free, `r` the robot's cell, which is the origin. Column j is x = 8 j - x_robot, row i is
y = 8 i - y_robot, row 0 first.
"""

from __future__ import annotations

import mujoco

from shes.errors import UnknownNameError

__all__ = [
    "CELL_SIZE_M",
    "GATHER",
    "INTEGRATORS",
    "TIMESTEP_S",
    "WALL_HEIGHT_M",
    "add_walls",
    "empty_world",
    "wall_boxes",
]

CELL_SIZE_M = 8.0
WALL_HEIGHT_M = 4.0
FLOOR_HALF_SIZE_M = 40.0
TIMESTEP_S = 0.02
"""Physics step."""

GATHER = ("#####", "#...#", "#.r.#", "#...#", "#####")

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


def empty_world(name: str, integrator: str) -> mujoco.MjSpec:
    """Return a world with a floor, the contact defaults of the tasks, and the integrator of this name.

    Raises:
        UnknownNameError: `integrator` is not one of `INTEGRATORS`.
    """
    if integrator not in INTEGRATORS:
        raise UnknownNameError("integrator", integrator, INTEGRATORS, "Set --integrator.")
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = True
    spec.option.timestep = TIMESTEP_S
    spec.option.integrator = INTEGRATORS[integrator]
    geom = spec.default.geom
    geom.condim = 3
    geom.contype = 1
    geom.conaffinity = 0  # no self-collision: only floor, walls and blocks take contacts
    geom.density = 5.0
    geom.friction = [1.0, 0.5, 0.5]
    geom.margin = 0.01
    geom.solref = [0.02, 1.0]
    geom.solimp = [0.8, 0.8, 0.01, 0.5, 2.0]
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[FLOOR_HALF_SIZE_M] * 3,
        conaffinity=1,
        rgba=[0.8, 0.9, 0.8, 1],
    )
    return spec


def wall_boxes(grid: tuple[str, ...]) -> list[tuple[float, float, float, float]]:
    """Return the walls of `grid` as boxes (x, y, half width, half depth) in metres.

    Neighbouring wall cells are merged, first along rows, then equal runs along columns: same contacts, less work.
    """
    robot_row = next(i for i, row in enumerate(grid) if "r" in row)
    robot_column = grid[robot_row].index("r")
    open_runs: dict[tuple[int, int], int] = {}  # (first column, last column) -> first row
    boxes: list[tuple[float, float, float, float]] = []

    def close(run: tuple[int, int], first_row: int, last_row: int) -> None:
        x = ((run[0] + run[1]) / 2 - robot_column) * CELL_SIZE_M
        y = ((first_row + last_row) / 2 - robot_row) * CELL_SIZE_M
        half = CELL_SIZE_M / 2
        boxes.append((x, y, (run[1] - run[0] + 1) * half, (last_row - first_row + 1) * half))

    for i, row in enumerate((*grid, "")):
        runs = _wall_runs(row)
        for run in [run for run in open_runs if run not in runs]:
            close(run, open_runs.pop(run), i - 1)
        for run in runs:
            open_runs.setdefault(run, i)
    return boxes


def _wall_runs(row: str) -> list[tuple[int, int]]:
    """Return the first and last column of every run of walls in `row`."""
    runs: list[tuple[int, int]] = []
    for j, cell in enumerate(row):
        if cell != "#":
            continue
        if runs and runs[-1][1] == j - 1:
            runs[-1] = (runs[-1][0], j)
        else:
            runs.append((j, j))
    return runs


def add_walls(spec: mujoco.MjSpec, grid: tuple[str, ...]) -> None:
    """Add the walls of `grid` to `spec`, standing on the floor."""
    for number, (x, y, half_width, half_depth) in enumerate(wall_boxes(grid)):
        spec.worldbody.add_geom(
            name=f"wall_{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, WALL_HEIGHT_M / 2],
            size=[half_width, half_depth, WALL_HEIGHT_M / 2],
            conaffinity=1,
            rgba=[0.9, 0.9, 0.9, 1],
        )
