"""Writing files so that nothing is ever half written."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from shes.errors import StorageError

__all__ = ["storage_errors", "write_atomically"]

_MENDS = {
    errno.ENOSPC: "the disk is full: make room, then go on with `shes resume`",
    errno.EDQUOT: "the disk quota is used up: make room, then go on with `shes resume`",
    errno.EFBIG: "the file is larger than allowed here: raise the limit, then go on with `shes resume`",
    errno.EROFS: "the file system is read-only: choose another folder with --out",
    errno.EACCES: "permission denied: choose a folder that you may write to with --out",
    errno.EPERM: "permission denied: choose a folder that you may write to with --out",
    errno.ENOENT: "there is no such folder: create it first, or choose another path with --out",
    errno.ENOTDIR: "a part of the path is a file: choose another folder with --out",
}


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn an operating system's error at `path` into one that says what to do.

    Raises:
        StorageError: The block raised OSError.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        mend = _MENDS.get(error.errno or 0, f"{error.strerror or error}")
        raise StorageError(f"cannot write {path}: {mend}. What was there before is untouched.") from error


def write_atomically(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a new file, make it durable, and put it in the place of `path`; on failure `path` stays.

    Raises:
        StorageError: The file cannot be written.
    """
    temporary: str | None = None
    with storage_errors(path):
        try:
            handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
            with os.fdopen(handle, "wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            Path(temporary).replace(path)
        finally:
            if temporary is not None:
                Path(temporary).unlink(missing_ok=True)
