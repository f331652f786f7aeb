"""A clock that a policy may observe, because a network without memory has no internal rhythm.

Source: Siekmann et al. 2021, section III (sine and cosine of a gait's phase as inputs).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from shes.types import F64Array, IntArray


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Sine and cosine of the time since the start of the episode, at one frequency."""

    size: ClassVar[int] = 2
    """Number of features."""
    frequency_hz: float
    """Frequency in simulated time."""
    step_s: float
    """Simulated time of a control step in seconds."""

    def write(self, steps: IntArray, out: F64Array) -> None:
        """Write sine and cosine into `out` [P, R, 2], for lanes `steps` [P] control steps after their start."""
        phase = (2 * np.pi * self.frequency_hz * self.step_s) * steps[:, None]
        np.sin(phase, out=out[..., 0])  # broadcast over the episodes of a lane, which started together
        np.cos(phase, out=out[..., 1])
