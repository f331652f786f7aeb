"""Array types and checks shared by all packages. Docstrings give shapes as `[axis, axis]`.

The letters of the axes are explained in `docs/reference/index.md`. Arrays are NumPy's, or CuPy's on a CUDA GPU: NumPy
functions accept both, and code that creates arrays uses the array module `xp`. `xp.asarray` transfers to the device,
`to_host` back.
"""

from __future__ import annotations

from typing import Any, Final, Protocol, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import NDArray

F32Array: TypeAlias = NDArray[np.float32]
F64Array: TypeAlias = NDArray[np.float64]
FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

CONTROLLER: Final = 0
"""Index of the controller's level in a hierarchical state."""
PRIMITIVE: Final = 1
"""Index of the primitive's level in a hierarchical state."""


class ArrayHeader(Protocol):
    """Shape and type of an array, which may still be in a file."""

    @property
    def shape(self) -> tuple[int, ...]: ...  # noqa: D102 - as of an array

    @property
    def dtype(self) -> np.dtype[Any]: ...  # noqa: D102


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether `value` is an integer of Python or NumPy; a bool or 25.0 is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def to_host(array: Any) -> NDArray[Any]:
    """Return `array` as a NumPy array: itself if it is one, else a copy, which waits for the device."""
    return array if isinstance(array, np.ndarray) else array.get()
