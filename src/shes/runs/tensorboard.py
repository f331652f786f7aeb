"""TensorBoard: a dozen charts of a run, the learning curves also against environment steps, and the hyperparameters.

Every other column is in the tables alone. `docs/how-to/track.md` lists the charts.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from time import time
from types import MappingProxyType
from typing import Any

import numpy as np
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog  # type: ignore[attr-defined] - made when imported
from tensorboardX.summary import hparams, scalar

from shes.storage import storage_errors

_GROUPS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "evaluation": {"evaluation": ("score_mean", "return_mean", "success_rate")},
    "progress": {
        "training": ("score_mean", "*_return_mean"),
        "update": ("*_update_ratio", "*_halves_cosine"),
        "episodes": ("episode_steps_mean",),
        "speed": ("env_steps_per_s",),
    },
}
"""Columns with a chart, by table and group; `*` is any level."""
_LEARNING = ("evaluation", "training")
"""Groups that are also drawn against environment steps."""
_METRICS = ("evaluation/score_mean", "evaluation/return_mean")
"""Charts that are compared in the tab of the hyperparameters."""


class Events:
    """The event files of a run, one against generations and one, in the folder `env_steps`, against steps.

    They are two because a run that continues hides the later events of a file, by their generation or their steps.
    """

    def __init__(
        self,
        folder: Path,
        generation: int,
        env_steps: int = 0,
        hyperparameters: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """Open files that supersede the events after `generation` and `env_steps`.

        The hyperparameters are written at generation 0 alone.
        """
        self._by_generation = _EventFile(folder, generation)
        self._by_env_steps = _EventFile(folder / "env_steps", env_steps)
        if not generation:
            self._by_generation.add_hyperparameters(hyperparameters)

    def add(self, table: str, row: Mapping[str, Any]) -> None:
        """Write the charts of a row of `table`, without values that are not finite."""
        charts = [(group, name, row[name]) for group, name in _charts(table, row) if np.isfinite(row[name])]
        self._by_generation.add({f"{group}/{name}": value for group, name, value in charts}, row["generation"])
        curves = {f"{group}_by_env_steps/{name}": value for group, name, value in charts if group in _LEARNING}
        self._by_env_steps.add(curves, row.get("env_steps", 0))

    def close(self) -> None:
        """Close the files."""
        self._by_generation.close()
        self._by_env_steps.close()


def _charts(table: str, columns: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield group and column of the charts of `table`."""
    for group, patterns in _GROUPS[table].items():
        for name in columns:
            if any(fnmatchcase(name, pattern) for pattern in patterns):
                yield group, name


class _EventFile:
    """A file of TensorBoard events, written in this thread.

    The thread of tensorboardX's `SummaryWriter` dies when the disk is full, and then blocks the run for ever.
    """

    def __init__(self, folder: Path, step: int) -> None:
        """Open a file that supersedes the events of earlier files after `step`."""
        self._folder = folder
        with storage_errors(folder):
            folder.mkdir(exist_ok=True)
            # The name contains the second; two parts of a run that begin in the same second need different files.
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}.{step}")
            if step:
                start = SessionLog(status=SessionLog.START)
                self._writer.write_event(Event(wall_time=time(), step=step + 1, session_log=start))

    def add(self, values: Mapping[str, float], step: int) -> None:
        """Write `values` by tag."""
        with storage_errors(self._folder):
            for tag, value in values.items():
                self._writer.write_event(Event(wall_time=time(), step=step, summary=scalar(tag, value)))
            self._writer.flush()  # before the checkpoint marks this generation as done

    def add_hyperparameters(self, values: Mapping[str, Any]) -> None:
        """Write the hyperparameters by name; what is neither a number nor a text is written as text."""
        shown = {name: value if isinstance(value, bool | int | float) else str(value) for name, value in values.items()}
        with storage_errors(self._folder):
            for summary in hparams(shown, dict.fromkeys(_METRICS))[:2]:  # the third says that the run has ended
                self._writer.write_event(Event(wall_time=time(), summary=summary))
            self._writer.flush()

    def close(self) -> None:
        """Close the file."""
        with storage_errors(self._folder):
            self._writer.close()
