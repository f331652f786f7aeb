"""Files that are written as a whole or not at all, on file systems with odd locks."""

import errno
import fcntl
import os

from shes.storage import write_atomically


def _write(path):
    write_atomically(path, lambda file: file.write(b"all"))


def test_a_file_removed_before_it_is_locked_is_begun_again(tmp_path, monkeypatch):
    flock, calls = fcntl.flock, []

    def unlink_first(file, operation):
        if not calls:
            (part,) = tmp_path.glob(".*.part")
            part.unlink()  # as another process does that holds its lock for a moment
        calls.append(operation)
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", unlink_first)
    _write(tmp_path / "a")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"all")]
    assert len(calls) == 2


def test_an_abandoned_file_is_removed_over_nfs(tmp_path, monkeypatch):
    flock = fcntl.flock

    def flock_of_nfs(file, operation):  # needs a file that is open for writing
        if not file.writable():
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", flock_of_nfs)
    (tmp_path / ".a.1.2.part").write_bytes(b"half")
    _write(tmp_path / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
