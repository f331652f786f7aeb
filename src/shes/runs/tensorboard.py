"""TensorBoard: a dozen charts of a run, and its hyperparameters. `docs/how-to/track.md` lists them.

Every other column is in the tables alone.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from time import time
from typing import Any

import numpy as np
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog  # type: ignore[attr-defined] - made when imported
from tensorboardX.summary import hparams, scalar

from shes.storage import storage_errors

_CHARTS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "evaluation": {"evaluation": ("score_mean", "return_mean", "success_rate")},
    "progress": {
        "training": ("score_mean", "*_return_mean"),
        "update": ("*_update_ratio", "*_halves_cosine"),
        "episodes": ("episode_steps_mean",),
        "speed": ("env_steps_per_s",),
    },
}
"""Columns with a chart, by table and group; `*` is any level."""
_COMPARED = ("evaluation/score_mean", "evaluation/return_mean")
"""Charts in the tab of the hyperparameters."""


class Events:
    """The event file of a run, written in this thread.

    The thread of tensorboardX's `SummaryWriter` dies when the disk is full, and then blocks the run for ever.
    """

    def __init__(self, folder: Path, generation: int, hyperparameters: Mapping[str, Any]) -> None:
        """Open a file that supersedes the events of earlier files after `generation`.

        The hyperparameters are written at generation 0 alone.
        """
        self._folder = folder
        with storage_errors(folder):
            folder.mkdir(exist_ok=True)
            # The name contains the second; two parts of a run that begin in the same second need different files.
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}.{generation}")
            if generation:
                start = SessionLog(status=SessionLog.START)
                self._writer.write_event(Event(wall_time=time(), step=generation + 1, session_log=start))
                return
            plain = {
                name: it if isinstance(it, bool | int | float) else str(it) for name, it in hyperparameters.items()
            }
            for summary in hparams(plain, dict.fromkeys(_COMPARED))[:2]:  # the third says that the run has ended
                self._writer.write_event(Event(wall_time=time(), summary=summary))

    def add(self, table: str, row: Mapping[str, Any]) -> None:
        """Write the charts of a row of `table`, without values that are not finite."""
        with storage_errors(self._folder):
            for group, patterns in _CHARTS[table].items():
                for name in row:
                    if any(fnmatchcase(name, pattern) for pattern in patterns) and np.isfinite(row[name]):
                        summary = scalar(f"{group}/{name}", row[name])
                        self._writer.write_event(Event(wall_time=time(), step=row["generation"], summary=summary))
            self._writer.flush()  # before the checkpoint marks this generation as done

    def close(self) -> None:
        """Close the file."""
        with storage_errors(self._folder):
            self._writer.close()
