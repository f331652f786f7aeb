"""Types that all packages share: arrays, and the listings that commands print.

Docstrings give shapes as `[axis, axis]`.

The letters of the axes are explained in `docs/reference/index.md`. Arrays are NumPy's, or CuPy's on a CUDA GPU: NumPy
functions accept both, and code that creates arrays uses the array module `xp`. `xp.asarray` transfers to the device,
`to_host` back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import NDArray

F32Array: TypeAlias = NDArray[np.float32]
F64Array: TypeAlias = NDArray[np.float64]
FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether `value` is an integer of Python or NumPy; a bool or 25.0 is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


class Table(NamedTuple):
    """A table of texts."""

    headings: Sequence[str]
    """Headings of the columns; empty for a table of names and values."""
    rows: Sequence[Sequence[str]]


class Listing(NamedTuple):
    """Output of a command."""

    facts: Any
    """All of it as JSON types."""
    parts: Sequence[Table | str]
    """Tables and lines, in order."""
    errors: Sequence[str] = ()
    """Messages about parts that failed."""


def facts_listing(facts: Mapping[str, Any]) -> Listing:
    """Return the listing of named values."""
    rows = [(name, f"{it:,.3f}" if isinstance(it, float) else str(it)) for name, it in facts.items()]
    return Listing(facts, [Table((), rows)])


def to_host(array: Any) -> NDArray[Any]:
    """Return `array` as a NumPy array: itself if it is one, else a copy, which waits for the device."""
    return array if isinstance(array, np.ndarray) else array.get()
