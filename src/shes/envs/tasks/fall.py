"""Fall: fill a chasm with a block and walk over it. Source: Nachum et al. 2018 (HIRO); HrlMuJoCoEnvs.jl."""

from __future__ import annotations

from typing import ClassVar

from shes.envs.tasks.target_task import BlockOptions, TargetTask
from shes.envs.worlds import WALL_HEIGHT_M, Grid


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
