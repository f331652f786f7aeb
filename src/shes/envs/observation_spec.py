"""Observation specs: name, meaning, unit and range of every observed value. Spaces and documentation use them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class ObservationElement:
    """One value of an observation."""

    name: str
    """Short name, unique in the observation, e.g. `torso_z`."""
    meaning: str
    unit: str = "1"
    """Unit after scaling; `1` for a dimensionless number."""
    low: float = -np.inf
    high: float = np.inf


def elements(
    names: Sequence[str], meaning: str, unit: str = "1", low: float = -np.inf, high: float = np.inf
) -> tuple[ObservationElement, ...]:
    """Return one element for each of `names`; `{}` in `meaning` is replaced by the name, with spaces."""
    return tuple(
        ObservationElement(name=name, meaning=meaning.format(name.replace("_", " ")), unit=unit, low=low, high=high)
        for name in names
    )
