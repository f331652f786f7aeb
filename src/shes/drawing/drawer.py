"""The contract of drawing: a drawer makes pictures of poses."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shes.envs.markers import Marker

Picture = NDArray[np.uint8]
"""Pixels [H, W, 3]."""


class Drawer(ABC):
    """Makes pictures, of one size, of the poses of one environment."""

    cameras: Sequence[str]
    """Names of its cameras."""

    @abstractmethod
    def draw(self, pose: Any, /, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture [H, W, 3] of `pose` with `markers`."""

    @abstractmethod
    def between(self, start: Any, end: Any, fraction: float) -> Any:
        """Return the pose a `fraction` of the way from `start` to `end`."""

    def close(self) -> None:  # noqa: B027 - some hold none
        """Release its resources."""
