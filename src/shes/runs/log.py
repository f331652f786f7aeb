"""The log of a run: when its generations begin and end, lost workers, the simulator's warnings."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from shes.runs.folder import RunFolder
from shes.storage import storage_errors

__all__ = ["logger", "run_log"]

logger = logging.getLogger("shes.run")


class _LogFile(logging.FileHandler):
    """A log that no full disk ends the run by: the tables and the checkpoints, written next, say it better."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's own name
        """Leave the record out."""

    def close(self) -> None:
        """Close the file, whatever is still unwritten."""
        with suppress(OSError):
            super().close()


@contextmanager
def run_log(folder: RunFolder) -> Iterator[None]:
    """Send the log of the run to its `log.txt`."""
    with storage_errors(folder.log):
        handler = _LogFile(folder.log, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    previous = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.level, logger.propagate = previous
        handler.close()
