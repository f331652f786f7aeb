"""Atomic writing of files."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from shes.errors import StorageError

__all__ = ["storage_errors", "write_atomically"]

_FIXES = {
    errno.ENOSPC: "the disk is full: make room, then start again (a run that had begun: `shes resume`)",
    errno.EDQUOT: "the disk quota is used up: make room, then start again (a run that had begun: `shes resume`)",
    errno.EFBIG: "the file is larger than allowed here: raise the limit, then start again (a run: `shes resume`)",
    errno.EROFS: "the file system is read-only: choose another folder with --out",
    errno.EACCES: "permission denied: choose a folder that you may write to with --out",
    errno.EPERM: "permission denied: choose a folder that you may write to with --out",
    errno.ENOENT: "there is no such folder: create it first, or choose another path with --out",
    errno.ENOTDIR: "a part of the path is a file: choose another folder with --out",
}


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Convert an OSError in the block into a StorageError that says how to fix it.

    Raises:
        StorageError: The block raised OSError.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        fix = _FIXES.get(error.errno or 0, f"{error.strerror or error}")
        raise StorageError(f"cannot write {path}: {fix}. What was there before is untouched.") from error


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a new file, flush it to the disk, and move it to `path`. On failure `path` is unchanged.

    Unfinished files of killed writers are removed.

    Raises:
        StorageError: The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    with storage_errors(path):
        _remove_abandoned(path)
        try:
            with temporary.open("wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


def _remove_abandoned(path: Path) -> None:
    """Remove unfinished copies of `path` whose writers no longer run."""
    for part in path.parent.glob(f".{path.name}.*.part"):
        writer = part.name.removeprefix(f".{path.name}.").partition(".")[0]
        if writer.isdecimal() and not _is_alive(int(writer)):
            part.unlink(missing_ok=True)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
