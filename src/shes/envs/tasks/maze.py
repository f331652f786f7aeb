"""Maze: around a wall to a target. Source: environment specification, Tasks."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from shes.envs.tasks.options import TARGET_SAMPLINGS, TaskOptions
from shes.envs.tasks.target_task import TargetTask
from shes.envs.worlds import MAZE, Grid, is_free
from shes.errors import ConfigError
from shes.types import F64Array

__all__ = ["Maze"]

SQUARE_M = (-4.0, 20.0)
"""Range of both coordinates of training's targets."""


class Maze(TargetTask):
    """A corridor in the shape of a U. In training the target is anywhere, in evaluation behind the wall.

    Training's targets are uniform in a square that covers walls too; `target_sampling="free_cells"` draws again until
    the cell is free. By either, some episodes of training begin where they
    are to end: 12 % of those in the square within 5 m of their target.
    """

    name: ClassVar[str] = "maze"
    heeds: ClassVar[frozenset[str]] = frozenset({"target_sampling", "target", "evaluation_target"})
    grid: ClassVar[Grid] = MAZE
    own_target: ClassVar[tuple[float, ...]] = (0.0, 16.0)
    target_scale: ClassVar[float] = 0.01

    @classmethod
    def check_options(cls, options: TaskOptions) -> None:
        """Refuse a way to draw targets where one is fixed."""
        super().check_options(options)
        if options.target is not None and options.target_sampling != TARGET_SAMPLINGS[0]:
            raise ConfigError(
                f"target {options.target} fixes training's target, so target_sampling {options.target_sampling!r} does "
                "nothing. Leave --target or --target-sampling away."
            )

    def training_target(self, rng: np.random.Generator) -> tuple[float, ...] | F64Array:
        """Draw x and y together."""
        while True:
            target = rng.uniform(*SQUARE_M, 2)
            if self.options.target_sampling != "free_cells" or is_free(self.grid, *target):
                return target
