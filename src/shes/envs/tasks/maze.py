"""Maze: around a wall to a target. Source: environment specification, Tasks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from shes.envs.tasks.target_task import TargetOptions, TargetTask
from shes.envs.worlds import MAZE, Grid, is_free
from shes.errors import ConfigError
from shes.types import F64Array

__all__ = ["Maze", "MazeOptions"]

SQUARE_M = (-4.0, 20.0)
"""Range of both coordinates of training's targets."""


@dataclass(frozen=True, kw_only=True)
class MazeOptions(TargetOptions):
    """Options of Maze."""

    target_sampling: Literal["square", "free_cells"] = "square"
    """Training's targets are uniform in the square [-4, 20] x [-4, 20] m that covers walls too, or there in free_cells
    only."""

    def check(self) -> None:
        """Refuse a way to draw targets where one is fixed."""
        if self.target is not None and self.target_sampling != "square":
            raise ConfigError(
                f"target {self.target} fixes training's target, so target_sampling {self.target_sampling!r} does "
                "nothing. Leave --target or --target-sampling away."
            )


class Maze(TargetTask):
    """A corridor in the shape of a U. In training the target is anywhere, in evaluation behind the wall.

    Training's targets are uniform in a square that covers walls too; `target_sampling="free_cells"` draws again until
    the cell is free. By either, some episodes of training begin where they
    are to end: 12 % of those in the square within 5 m of their target.
    """

    name: ClassVar[str] = "maze"
    Options = MazeOptions
    options: MazeOptions  # type: ignore[assignment] - narrower than that of every target task
    grid: ClassVar[Grid] = MAZE
    own_target: ClassVar[tuple[float, ...]] = (0.0, 16.0)
    target_scale: ClassVar[float] = 0.01

    def training_target(self, rng: np.random.Generator) -> tuple[float, ...] | F64Array:
        """Draw x and y together."""
        while True:
            target = rng.uniform(*SQUARE_M, 2)
            if self.options.target_sampling != "free_cells" or is_free(self.grid, *target):
                return target
