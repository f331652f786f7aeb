"""The thread that writes the tables and checkpoints of a run, so that training never waits for a disk."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Lock, Thread

from shes.runs.checkpoint import Checkpoint, save_checkpoint
from shes.runs.tables import Records, Row


class RunWriter:
    """Writes rows and checkpoints in the order in which they are given.

    Of two checkpoints for one file that both wait, only the newer one is written.
    """

    def __init__(self, records: Records) -> None:
        """Begin to write to these tables."""
        self._records = records
        self._waiting: SimpleQueue[Callable[[], None] | Event | None] = SimpleQueue()
        self._newest: dict[Path, tuple[int, Checkpoint]] = {}  # of those that wait
        self._lock = Lock()  # of `_newest`
        self._numbers = count()
        self._error: Exception | None = None
        self._thread = Thread(target=self._write_all, name="shes-writer", daemon=True)
        self._thread.start()

    def add_row(self, table: str, row: Row) -> None:
        """Let a row be added; raise StorageError if anything before could not be written."""
        self._put(lambda: self._records.add(table, row))

    def save(self, path: Path, checkpoint: Checkpoint) -> None:
        """Let a checkpoint be written; raise StorageError if anything before could not be written."""
        number = next(self._numbers)
        with self._lock:
            self._newest[path] = number, checkpoint
        self._put(lambda: self._save(path, number))

    def wait(self) -> None:
        """Wait until all is written; raise StorageError if anything could not be written."""
        done = Event()
        self._waiting.put(done)
        done.wait()
        self._raise()

    def close(self) -> None:
        """Write all pending rows and end the thread; raise StorageError if anything could not be written."""
        self._waiting.put(None)
        self._thread.join()
        self._raise()

    def _put(self, write: Callable[[], None]) -> None:
        self._raise()
        self._waiting.put(write)

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _save(self, path: Path, number: int) -> None:
        with self._lock:
            newest, checkpoint = self._newest[path]
            if number != newest:  # it is written later, after the rows that belong to it
                return
            del self._newest[path]
        self._records.flush()
        save_checkpoint(path, checkpoint)

    def _write_all(self) -> None:
        """Write until `close`. After an error nothing more is written: a checkpoint needs the rows before it."""
        has_failed = False
        while (write := self._waiting.get()) is not None:
            if isinstance(write, Event):
                write.set()
                continue
            if has_failed:
                continue
            try:
                write()
            except Exception as error:  # noqa: BLE001 - raised by the next call
                self._error, has_failed = error, True
