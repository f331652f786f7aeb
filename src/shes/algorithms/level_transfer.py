"""The contract of a transfer: a run that begins with a level of another run. Source: SHES paper, II-D."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from shes.algorithms.problem import Problem


class LevelTransfer(ABC):
    """The transfer of a level between runs of algorithms that have this object in `Algorithm.transfers`.

    A setting with the name of the level gives the other run, and `LEVEL_checkpoint` its checkpoint.
    """

    trained_by: ClassVar[str]
    """Runs that train such a level, for error messages."""
    advice: ClassVar[str]
    """Advice in the error message about a level that does not fit."""
    suggested: ClassVar[tuple[str, ...]] = ()
    """Settings that come with the level unless another value is asked for."""

    @abstractmethod
    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the settings that a level of a run with settings `source` brings to a run of levels `level_names`."""

    @abstractmethod
    def interface(self, problem: Problem) -> str:
        """Return the inputs and outputs of the level in words. Both runs must have the same."""

    @abstractmethod
    def move(self, source: Any, state: Any) -> Any:
        """Return `state` with the parameters and statistics of the level in state `source`."""

    def is_egocentric(self, source: Any) -> bool:
        """Return whether the level of a run with settings `source` sees the robot's state in its own frame."""
        return False
