"""Atomic writing of files."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import IO, Any

from shes.errors import StorageError

_UNFINISHED = ".part"

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
    """Convert an OSError in the block into a StorageError that says how to fix it."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        fix = _FIXES.get(error.errno or 0, f"{error.strerror or error}")
        raise StorageError(f"cannot write {path}: {fix}. What was there before is untouched.") from error


def can_lock(file: IO[Any], *, is_shared: bool = False) -> bool:
    """Take the lock of an open file, if no other process holds it; return whether none does.

    On a file system without locks that is not known, and none is assumed to.
    """
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # the latter: where byte ranges are locked instead, as over NFS
        return False
    except OSError:
        return True
    return True


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a new file, flush it to the disk, and move it to `path`. On failure `path` is unchanged.

    Unfinished files of killed writers are removed.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}{_UNFINISHED}")
    with storage_errors(path):
        remove_abandoned(path.parent, escape(path.name))
        try:
            while True:
                with temporary.open("xb") as file:  # never through a symbolic link
                    with suppress(OSError):  # a file system without locks
                        fcntl.flock(file, fcntl.LOCK_EX)
                    if not temporary.exists():  # taken for abandoned before it was locked
                        continue
                    write(file)
                    file.flush()
                    os.fsync(file.fileno())
                    temporary.replace(path)
                    return
        finally:
            temporary.unlink(missing_ok=True)


def remove_abandoned(folder: Path, name: str) -> None:
    """Remove unfinished copies of the files called `name`, a pattern, whose writers no longer run.

    A writer holds a lock on its copy, which ends with it, on any machine that shares the folder.
    """
    for part in folder.glob(f".{name}.*.*{_UNFINISHED}"):
        with suppress(OSError), part.open("r+b") as file:  # for writing: NFS locks no other file exclusively
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            part.unlink(missing_ok=True)
