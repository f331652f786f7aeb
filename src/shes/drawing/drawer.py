"""The contracts of drawing: a drawer makes pictures of poses, a window shows poses in real time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

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


class Window(Protocol):
    """Shows poses in real time."""

    @property
    def is_open(self) -> bool:
        """Whether the window is open."""
        ...

    def show(self, pose: Any, /, markers: Sequence[Marker] = (), *, is_new_episode: bool = False) -> None:
        """Move from the last pose to `pose`, with `markers`, in the time of a control step."""
        ...

    def close(self) -> None:
        """Close the window."""
        ...
