"""Fall: fill a chasm with a block and walk over it. Source: environment specification, Tasks."""

from __future__ import annotations

from typing import ClassVar

from shes.envs.tasks.target_task import BlockOptions, TargetTask
from shes.envs.worlds import FALL, WALL_HEIGHT_M, Grid

__all__ = ["Fall"]


class Fall(TargetTask):
    """Platforms 4 m high, with a chasm between robot and target. A block pushed into it becomes a bridge.

    A robot in the chasm goes on to the end of the episode: nothing ends early.
    """

    name: ClassVar[str] = "fall"
    Options = BlockOptions
    grid: ClassVar[Grid] = FALL
    ground_m: ClassVar[float] = WALL_HEIGHT_M
    block_axes: ClassVar[str] = "yz"
    own_target: ClassVar[tuple[float, ...]] = (0.0, 27.0, 4.5)
