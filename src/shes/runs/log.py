"""The log of a run: begin and end of generations, lost workers, warnings of the simulator."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue

from shes.runs.folder import RunFolder
from shes.storage import storage_errors

logger = logging.getLogger("shes.run")


class _LogFile(logging.FileHandler):
    """A log file whose errors are ignored: a full disk ends the run when tables or checkpoints are written."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's own name
        """Drop the record."""

    def close(self) -> None:
        """Close the file, even if buffered text cannot be written."""
        with suppress(OSError):
            super().close()


@contextmanager
def run_log(folder: RunFolder) -> Iterator[None]:
    """Write the log of the run to its `log.txt` inside the block, in a thread: the run does not wait for the disk.

    An error that ends the block is logged with its traceback, which says where in the user's own code it began.
    """
    with storage_errors(folder.log):
        file = _LogFile(folder.log, encoding="utf-8")
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    queue: SimpleQueue[logging.LogRecord] = SimpleQueue()
    handler, writer = QueueHandler(queue), QueueListener(queue, file)
    writer.start()
    previous = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    except Exception as error:
        for line in "".join(traceback.format_exception(error)).splitlines():
            logger.log(logging.ERROR, "%s", line)
        raise
    finally:
        logger.removeHandler(handler)
        logger.level, logger.propagate = previous
        writer.stop()
        file.close()
