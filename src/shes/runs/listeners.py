"""Listeners: they receive the progress of a run, and may end it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np

from shes.errors import ConfigError, UnknownNameError
from shes.runs.config import TrainConfig
from shes.runs.tables import Row


class StopTraining(Exception):  # noqa: N818 - a request, as StopIteration is
    """Raised by a listener to end the run after this generation, as if it were over."""


class Listener(Protocol):
    """Receives the progress of a run. A listener has any of these methods; one that returns True ends the run."""

    def on_start(self, path: Path, config: TrainConfig, generation: int, num_workers: int) -> bool | None:
        """Receive the start of the run at `path`, after `generation`."""

    def on_generation(self, row: Row) -> bool | None:
        """Receive a row of `progress.csv`."""

    def on_evaluation(self, row: Row) -> bool | None:
        """Receive a row of `evaluation.csv`."""

    def on_event(self, event: str) -> bool | None:
        """Receive a warning: a silent or lost worker, diverged episodes, or one of the simulator."""


AnyListener: TypeAlias = "Callable[[Row], Any] | object | Sequence[Any] | None"
"""A function of a row of `progress.csv`, an object with any method of `Listener`, several of these, or None."""

_METHODS = {
    name: tuple(inspect.signature(method).parameters)[1:]
    for name, method in vars(Listener).items()
    if name.startswith("on_")
}
"""Parameters of every method of a listener."""


class Listeners:
    """The listeners of a run."""

    def __init__(self, listener: AnyListener) -> None:
        """Raise ConfigError or UnknownNameError unless each is a function of a row or has methods of `Listener`."""
        each = listener if isinstance(listener, list | tuple) else () if listener is None else (listener,)
        self._methods = [_methods(one) for one in each]

    def tell(self, method: str, *content: Any) -> bool:
        """Call `method` of every listener that has it; return whether one asks to end the run."""
        wants_end = False
        for methods in self._methods:
            if method in methods:
                try:
                    answer = methods[method](*content)
                except StopTraining:
                    answer = True
                wants_end |= isinstance(answer, bool | np.bool_) and bool(answer)
        return wants_end


def _methods(listener: Any) -> dict[str, Callable[..., Any]]:
    """Return the methods of a listener by name; a plain function is its `on_generation`."""
    if isinstance(listener, type):
        raise ConfigError(
            f"listener must be an object, got the class {listener.__name__}. Write {listener.__name__}()."
        )
    names = [name for name in dir(listener) if name.startswith("on_") and callable(getattr(listener, name))]
    for name in names:
        if name not in _METHODS:
            raise UnknownNameError("method of a listener", name, _METHODS, "Rename it.")
    found = {name: getattr(listener, name) for name in names}
    if not found and callable(listener):
        found = {"on_generation": listener}
    if not found:
        raise ConfigError(
            f"listener must be a function of a row, or an object with any of {', '.join(_METHODS)}; got {listener!r}."
        )
    for name, method in found.items():
        shown = getattr(method, "__qualname__", repr(method))
        if inspect.iscoroutinefunction(method):
            raise ConfigError(f"listener {shown} must be a plain function, not an async one.")
        try:
            inspect.signature(method).bind(*_METHODS[name])
        except TypeError as error:
            raise ConfigError(f"listener {shown} must take ({', '.join(_METHODS[name])}): {error}.") from error
        except ValueError:  # some built-in functions have no signature
            pass
    return found
