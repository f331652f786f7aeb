"""Ctrl-C in a training run: files are completed, and `shes resume` repeats the interrupted generation."""

from __future__ import annotations

import shlex
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Interruption:
    """A context that delays Ctrl-C and SIGTERM while files are written; the second signal ends the run at once."""

    def __init__(self) -> None:
        self.is_requested = False
        self._may_raise = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: object) -> None:
        is_second, self.is_requested = self.is_requested, True
        if self._may_raise or is_second:
            raise KeyboardInterrupt

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Raise KeyboardInterrupt at once for a signal inside this block, which writes no file."""
        try:
            self._may_raise = True
            if self.is_requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._may_raise = False


@contextmanager
def resumable(path: Path | str) -> Iterator[None]:
    """Add to a KeyboardInterrupt the note that the run, or the folder of runs, at `path` can be resumed."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note(f"Stopped; all finished generations are kept. Go on: shes resume {shlex.quote(str(path))}")
        raise
