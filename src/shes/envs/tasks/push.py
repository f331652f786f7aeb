"""Push: move a block out of the way. Source: Nachum et al. 2018 (HIRO); HrlMuJoCoEnvs.jl."""

from __future__ import annotations

from typing import ClassVar

from shes.envs.tasks.target_task import BlockOptions, TargetTask
from shes.envs.worlds import Grid


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
