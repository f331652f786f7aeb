"""What kind of value somebody gave. NumPy's numbers are as good as Python's; a bool is no number."""

from __future__ import annotations

from typing import Any, TypeGuard

import numpy as np

__all__ = ["is_number", "is_switch", "is_whole"]


def is_whole(value: Any) -> TypeGuard[int]:
    """Tell whether `value` is a whole number: 25, not 25.0."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_number(value: Any) -> TypeGuard[float]:
    """Tell whether `value` is a real number; NaN and infinity are."""
    return is_whole(value) or isinstance(value, float | np.floating)


def is_switch(value: Any) -> TypeGuard[bool]:
    """Tell whether `value` is True or False."""
    return isinstance(value, bool | np.bool_)
