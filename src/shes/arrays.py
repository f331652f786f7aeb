"""Arrays that may live on a device: NumPy's, or CuPy's on a CUDA card.

NumPy's functions work on both where they are given an array: they hand the work to CuPy. What makes arrays of nothing
takes the module, `xp`; a transfer is `xp.asarray` one way and `to_host` the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["to_host"]


def to_host(array: Any) -> NDArray[Any]:
    """Return `array` as one of NumPy's: itself where it is one, else a copy, for which the device is waited for."""
    return array if isinstance(array, np.ndarray) else array.get()
