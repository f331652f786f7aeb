"""Array types and checks shared by all packages. Docstrings give shapes as `[axis, axis]`.

Axes: n members of the population, G mirrored groups, M members of a group, L levels, D parameters of a policy; P lanes,
R rows (episodes) of a lane, N = P * R episodes in lockstep; E episodes of a member, K episodes of a task or an
evaluation; O observed values, V values of a view, A controls, J successive goals, T elements of a robot's symmetry
group, S numbers of a full physics state; H and W pixels. In `shes.algorithms.hiro`: B transitions of a batch, K
updates, M transitions in a replay buffer, J candidates for a goal, G coordinates of a goal.
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
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the elements."""
        ...


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether `value` is an integer of Python or NumPy; a bool or 25.0 is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
