"""Checks of what kind of value an argument is."""

from __future__ import annotations

from typing import Any, TypeGuard

import numpy as np


def is_whole(value: Any) -> TypeGuard[int]:
    """Return whether `value` is an integer of Python or NumPy; a bool or 25.0 is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
