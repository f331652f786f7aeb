"""Array types shared by every room. Shapes are written in docstrings as `[axis, axis]`.

Axes: P policies, E episodes of a policy, N = P * E simulations, L levels, D parameters, O observation, A action,
G mirrored groups, M members of a group.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["CONTROLLER", "PRIMITIVE", "BoolArray", "F32Array", "F64Array", "FloatArray", "IntArray"]

F32Array: TypeAlias = NDArray[np.float32]
F64Array: TypeAlias = NDArray[np.float64]
FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

CONTROLLER: Final = 0
"""Index of the controller's level in a hierarchical state."""
PRIMITIVE: Final = 1
"""Index of the primitive's level in a hierarchical state."""
