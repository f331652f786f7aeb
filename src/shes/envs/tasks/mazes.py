"""Maze, Push and Fall: reach a target in a world with walls, a block or a chasm.

Source: Nachum et al. 2018 (HIRO); the SHES authors' HrlMuJoCoEnvs.jl.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from shes.envs.tasks.target_task import BlockOptions, TargetOptions, TargetTask
from shes.envs.worlds import WALL_HEIGHT_M, Grid, is_free
from shes.errors import ConfigError
from shes.types import F64Array

SQUARE_M = (-4.0, 20.0)
"""Range of both coordinates of training's targets."""


@dataclass(frozen=True, kw_only=True)
class MazeOptions(TargetOptions):
    """Options of Maze."""

    target_sampling: Literal["square", "free_cells"] = "square"
    """Distribution of training's targets: uniform in the square [-4, 20] x [-4, 20] m, walls included, or uniform in
    its free_cells."""

    @property
    def has_random_target(self) -> bool:
        """Whether training's target is drawn for each episode."""
        return self.target is None

    def check(self) -> None:
        """Check that `target_sampling` has an effect, and that `waypoints` lead to a fixed target."""
        if self.target is not None and self.target_sampling != "square":
            raise ConfigError(
                f"target {self.target} fixes training's target, so target_sampling {self.target_sampling!r} has no "
                "effect. Omit --target-sampling, or set --target none and --waypoints none."
            )
        if self.waypoints is not None and self.has_random_target and not self.evaluation:
            raise ConfigError(
                f"waypoints {self.waypoints} need a fixed target, but the training target is random. "
                f"Set --target, e.g. --target {' '.join(f'{x:g}' for x in Maze.own_target)}, or --waypoints none."
            )


class Maze(TargetTask):
    """A U-shaped corridor. In training the target is random, in evaluation it lies behind the wall.

    Training's targets are uniform in a square that contains walls; with `target_sampling="free_cells"` a target in a
    wall is drawn again. In both cases some episodes begin near their target: 12 % of those in the square start within
    5 m of it.
    """

    name: ClassVar[str] = "maze"
    Options = MazeOptions
    options: MazeOptions  # type: ignore[assignment] - narrower than in TargetTask
    grid: ClassVar[Grid] = ("#####", "#r..#", "###.#", "#...#", "#####")
    own_target: ClassVar[tuple[float, ...]] = (0.0, 16.0)
    target_scale: ClassVar[float] = 0.01

    def training_target(self, rng: np.random.Generator) -> tuple[float, ...] | F64Array:
        """Draw x and y, uniform in the square."""
        while True:
            target = rng.uniform(*SQUARE_M, 2)
            if self.options.target_sampling != "free_cells" or is_free(self.grid, *target):
                return target


class Push(TargetTask):
    """A block stands in the way. Pushed straight ahead it closes the passage; pushed aside it opens it.

    The block weighs 0.2 g, as published, which makes its contacts soft: when rammed against a wall, a point sinks in by
    up to 0.35 m (its centre) and an ant's foot by up to 0.54 m, and is then pushed out again.
    """

    name: ClassVar[str] = "push"
    Options = BlockOptions
    grid: ClassVar[Grid] = ("#####", "#.r##", "#.B.#", "##.##", "#####")
    block_axes: ClassVar[str] = "xy"
    own_target: ClassVar[tuple[float, ...]] = (0.0, 19.0)


class Fall(TargetTask):
    """A chasm lies between robot and target, which stand on platforms 4 m high. A block pushed into it is a bridge.

    An episode never terminates: a robot that has fallen into the chasm stays there until the time limit.
    """

    name: ClassVar[str] = "fall"
    Options = BlockOptions
    grid: ClassVar[Grid] = ("####", "#r.#", "#.B#", "#CC#", "#..#", "####")
    ground_m: ClassVar[float] = WALL_HEIGHT_M
    block_axes: ClassVar[str] = "yz"
    own_target: ClassVar[tuple[float, ...]] = (0.0, 27.0, 4.5)
