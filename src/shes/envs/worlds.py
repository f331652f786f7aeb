"""Builds worlds: a grid of cells becomes static boxes and a movable block in a MuJoCo model.

A cell is `#` wall, `.` free, `r` free and the robot's start (the origin), `B` movable block, or `C` chasm. Column j is
at x = 8 j - x_robot and row i at y = 8 i - y_robot. In a world with a chasm all other cells are platforms 4 m high.

Source: Nachum et al. 2018 (HIRO); the SHES authors' HrlMuJoCoEnvs.jl; `docs/environments/index.md`, *Worlds*.
"""

from __future__ import annotations

import re

import mujoco

Grid = tuple[str, ...]
"""Rows of cells, row 0 first."""

CELL_SIZE_M = 8.0
WALL_HEIGHT_M = 4.0
"""Height of walls, platforms and blocks."""
SCALE = "scale"
"""Name of the number in a model by which its lengths are those below times this; without it they are these."""
FLOOR_HALF_SIZE_M = 40.0
ARENA: Grid = ("#####", "#...#", "#.r.#", "#...#", "#####")
"""A square without obstacles, of Gather and Flagrun."""

BLOCK_MASS_KG = 0.0002
FALLING_BLOCK_MASS_KG = 0.001
FALLING_BLOCK_SHRINK = 0.99
"""Factor on the width of a block that can fall, so that it fits between the platforms."""
BLOCK_MARGIN_M = 0.01

_SOLIMP = [0.8, 0.8, 0.01, 0.5, 2.0]
_STIFF_SOLIMP = [0.995, 0.995, 0.01, 0.5, 2.0]

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


def empty_world(name: str, integrator: str, timestep_s: float = 0.02, *, stiff_contacts: bool = False) -> mujoco.MjSpec:
    """Return a world with a floor and the contact parameters of the tasks, or the stiff ones of tasks with a block."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = True
    spec.option.timestep = timestep_s
    spec.option.integrator = INTEGRATORS[integrator]
    geom = spec.default.geom
    geom.condim = 3
    geom.contype = 1
    geom.conaffinity = 0  # no self-collision: only floor, walls and blocks have it set
    geom.density = 5.0
    geom.friction = [1.0, 0.5, 0.5]
    geom.margin = 0.01
    geom.solref = [0.02, 1.0]
    geom.solimp = _STIFF_SOLIMP if stiff_contacts else _SOLIMP
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[FLOOR_HALF_SIZE_M] * 3, conaffinity=1)
    return spec


def add_grid(spec: mujoco.MjSpec, grid: Grid, scale: float = 1.0, block_factor: float = 1.0) -> None:
    """Add the walls, platforms and blocks of `grid` to `spec`, their lengths times `scale`.

    `block_factor` is the factor on the mass of blocks.
    """
    has_chasm = any("C" in row for row in grid)
    if has_chasm:
        _add_boxes(spec, "platform", merged_boxes(grid, "#.rB"), 0.0, scale)
    ground = WALL_HEIGHT_M if has_chasm else 0.0
    _add_boxes(spec, "wall", merged_boxes(grid, "#"), ground, scale)
    for i, row in enumerate(grid):
        if "B" in row:
            mass = block_factor * (FALLING_BLOCK_MASS_KG if has_chasm else BLOCK_MASS_KG)
            _add_block(spec, _center(grid, i, row.index("B")), ground, scale, mass, can_fall=has_chasm)


def add_square_walls(spec: mujoco.MjSpec, half_width: float, scale: float) -> None:
    """Add walls around the square of `half_width` metres that is centred at the origin, lengths times `scale`."""
    half = CELL_SIZE_M / 2
    middle, outer = half_width + half, half_width + CELL_SIZE_M
    boxes = [(0.0, y, outer, half) for y in (-middle, middle)]
    _add_boxes(spec, "wall", boxes + [(x, 0.0, half, half_width) for x in (-middle, middle)], 0.0, scale)


def merged_boxes(grid: Grid, signs: str) -> list[tuple[float, float, float, float]]:
    """Return the cells of `grid` that are one of `signs` as boxes (x, y, half width, half depth) in metres.

    Adjacent cells are merged, first along rows, then equal runs along columns, which makes the simulation faster.

    Deviation: a geom at the seam of two cells has one contact, where with one box per cell it has one with each box.
    Elsewhere contacts differ by rounding only.
    """
    open_runs: dict[tuple[int, int], int] = {}  # (first column, last column) -> first row
    boxes: list[tuple[float, float, float, float]] = []
    half = CELL_SIZE_M / 2
    for i, row in enumerate((*grid, "")):
        runs = [(run.start(), run.end() - 1) for run in re.finditer(f"[{re.escape(signs)}]+", row)]
        for run in [run for run in open_runs if run not in runs]:
            left, low = _center(grid, open_runs.pop(run), run[0])
            right, high = _center(grid, i - 1, run[1])
            boxes.append(((left + right) / 2, (low + high) / 2, (right - left) / 2 + half, (high - low) / 2 + half))
        for run in runs:
            open_runs.setdefault(run, i)
    return boxes


def _center(grid: Grid, i: int, j: int) -> tuple[float, float]:
    """Return the centre (x, y) in metres of the cell in row `i`, column `j`."""
    row = next(i for i, cells in enumerate(grid) if "r" in cells)
    column = grid[row].index("r")
    return (j - column) * CELL_SIZE_M, (i - row) * CELL_SIZE_M


def _add_boxes(
    spec: mujoco.MjSpec, name: str, boxes: list[tuple[float, float, float, float]], ground: float, scale: float
) -> None:
    """Add static boxes (x, y, half width, half depth) on ground of height `ground`, lengths times `scale`."""
    for number, (x, y, half_width, half_depth) in enumerate(boxes):
        spec.worldbody.add_geom(
            name=f"{name}_{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[scale * x, scale * y, scale * (ground + WALL_HEIGHT_M / 2)],
            size=[scale * half_width, scale * half_depth, scale * WALL_HEIGHT_M / 2],
            conaffinity=1,
        )


def _add_block(
    spec: mujoco.MjSpec, center: tuple[float, float], ground: float, scale: float, mass: float, *, can_fall: bool
) -> None:
    """Add a block that fills a cell and slides along x and y or, if it can fall, along y and z.

    Deviation: the limit along y of a block that can fall is as stiff as the contacts. With MuJoCo's soft default, a
    block that is pushed hard slides onto the far platform (measured: by 0.6 m and more) and opens a gap behind it.
    """
    body = spec.worldbody.add_body(name="block", pos=[scale * each for each in (*center, ground + WALL_HEIGHT_M / 2)])
    half = scale * CELL_SIZE_M / 2 * (FALLING_BLOCK_SHRINK if can_fall else 1.0)
    for axis in "yz" if can_fall else "xy":
        joint = body.add_joint(
            name=f"block_{axis}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[float(axis == each) for each in "xyz"],
            margin=BLOCK_MARGIN_M,
        )
        if can_fall:
            joint.limited = True
            joint.range = [-scale * WALL_HEIGHT_M, 0.0] if axis == "z" else [-scale * CELL_SIZE_M, scale * CELL_SIZE_M]
            if axis == "y":
                joint.solimp_limit = _STIFF_SOLIMP
    body.add_geom(
        name="block",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half, half, scale * WALL_HEIGHT_M / 2],
        mass=mass,
        margin=BLOCK_MARGIN_M,
        conaffinity=1,
    )
