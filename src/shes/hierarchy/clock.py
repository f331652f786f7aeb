"""A clock that a policy may observe: a rhythm to walk by, which a network without memory has not.

Source: algorithm options; e.g. Siekmann et al. 2021, section III (sine and cosine of a gait's phase as inputs).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from shes.types import F64Array, IntArray

__all__ = ["Clock"]


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Sine and cosine of the time since the episode's start, at one frequency."""

    size: ClassVar[int] = 2
    """Number of features."""
    frequency_hz: float
    """Turns in a second of simulated time."""
    step_s: float
    """Simulated time of a control step, in seconds."""

    def write(self, steps: IntArray, out: F64Array) -> None:
        """Write sine and cosine into `out` [P, R, 2] for lanes that have made `steps` [P]."""
        phase = (2 * np.pi * self.frequency_hz * self.step_s) * steps[:, None]
        np.sin(phase, out=out[..., 0])  # broadcasts over a policy's episodes, which began together
        np.cos(phase, out=out[..., 1])
