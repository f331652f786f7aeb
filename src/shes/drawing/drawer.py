"""What makes poses visible: a drawer makes pictures of them, a window shows them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shes.envs.markers import Marker

__all__ = ["Drawer", "Picture", "Window"]

Picture = NDArray[np.uint8]
"""Pixels [H, W, 3]."""


class Drawer(ABC):
    """Makes pictures of the poses of one environment, all of one size."""

    cameras: Sequence[str]
    """Where it can look from."""

    @abstractmethod
    def draw(self, pose: Any, /, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture [H, W, 3] of `pose`, with `markers` in it."""

    @abstractmethod
    def between(self, start: Any, end: Any, fraction: float) -> Any:
        """Return the pose a `fraction` of the way from `start` to `end`."""

    @abstractmethod
    def close(self) -> None:
        """Give back what it holds."""


class Window(Protocol):
    """Shows poses in real time."""

    @property
    def is_open(self) -> bool:
        """Whether it has not been closed."""
        ...

    def show(self, pose: Any, /, markers: Sequence[Marker] = (), *, is_new_episode: bool = False) -> None:
        """Move from the last pose to `pose`, with `markers` about, in the time of a control step."""
        ...

    def close(self) -> None:
        """Close it."""
        ...
