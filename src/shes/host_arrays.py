"""Arrays on the host or on a device: NumPy's, or CuPy's on a CUDA GPU.

NumPy functions accept both, because they dispatch to CuPy. Code that creates arrays uses the array module `xp`.
`xp.asarray` transfers to the device, `to_host` back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["to_host"]


def to_host(array: Any) -> NDArray[Any]:
    """Return `array` as a NumPy array: itself if it is one, else a copy, which waits for the device."""
    return array if isinstance(array, np.ndarray) else array.get()
