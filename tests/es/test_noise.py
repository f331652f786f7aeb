"""The noise table: its numbers, and the file that holds them."""

import errno
import io
import os
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes import storage
from shes.errors import ConfigError, StorageError
from shes.es import noise
from shes.es.noise import NOISE_SEED, NoiseTable, default_cache_dir

BLOCK = 1 << 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


@pytest.fixture(scope="module")
def table(folder):
    return NoiseTable.open(BLOCK + 3000, directory=folder)


@pytest.fixture(scope="module")
def content(table):
    return np.fromfile(table.path, dtype="<f4")


@given(data=st.data())
def test_every_slice_lies_inside_the_table_and_is_the_files_content(table, content, data):
    dim = data.draw(st.integers(1, 5000))
    index = data.draw(st.integers(0, table.size - dim))
    vector = table.slice(index, dim)
    assert vector.shape == (dim,)
    assert vector.dtype == np.float32
    assert vector.tobytes() == content[index : index + dim].tobytes()


def test_a_slice_is_a_view_and_cannot_be_written(table):
    assert np.shares_memory(table.slice(10, 5), table.values)
    with pytest.raises(ValueError, match="read-only"):
        table.slice(10, 5)[0] = 1


@pytest.mark.parametrize("size", [1, 7, 4096, 4097, 50_000])
def test_the_same_seed_gives_the_same_table_elsewhere(tmp_path, content, size):
    again = NoiseTable.open(size, directory=tmp_path)
    assert again.size == size
    assert np.array_equal(again.values, content[:size])


def test_tables_of_different_size_share_their_common_prefix_across_blocks(tmp_path, content):
    longer = NoiseTable.open(BLOCK + 9000, directory=tmp_path)
    assert np.array_equal(longer.values[: len(content)], content)


def test_another_seed_gives_another_table_beside_the_first(tmp_path):
    first, second = (NoiseTable.open(1000, seed, directory=tmp_path) for seed in (123, 124))
    assert not np.array_equal(first.values, second.values)
    assert first.path != second.path
    assert len(list(tmp_path.glob("*.f32"))) == 2


def test_the_table_holds_standard_normals(content):
    n = len(content)
    assert abs(content.mean(dtype=np.float64)) < 4 / np.sqrt(n)
    assert content.std(dtype=np.float64) == pytest.approx(1, abs=4 / np.sqrt(2 * n))
    assert np.mean(np.abs(content) < 1) == pytest.approx(0.6827, abs=0.002)
    assert np.mean(np.abs(content) > 3) == pytest.approx(0.0027, abs=0.0003)


def test_blocks_are_different_and_uncorrelated(content):
    tail = content[BLOCK:]
    assert abs(np.corrcoef(content[: len(tail)], tail)[0, 1]) < 0.08


def test_the_first_numbers_of_the_table_never_change(content):
    # A change here changes the results of every run: raise `_FORMAT`, and say so in the CHANGELOG.
    assert NOISE_SEED == 123
    assert content[:4] == pytest.approx([-1.0154525, -0.46104807, -0.042525586, 0.95501006], rel=1e-6)
    assert content[BLOCK : BLOCK + 4] == pytest.approx([-0.67301446, 0.47767088, -0.0903391, -0.45826763], rel=1e-6)


def test_opening_again_does_not_write_the_file(tmp_path, monkeypatch):
    path = NoiseTable.open(9000, directory=tmp_path).path
    os.utime(path, ns=(1, 1))
    inode = path.stat().st_ino

    def refuse(*_):
        raise AssertionError("the table was built again")

    monkeypatch.setattr(NoiseTable, "_build", staticmethod(refuse))
    assert NoiseTable.open(9000, directory=tmp_path).size == 9000
    assert (path.stat().st_mtime_ns, path.stat().st_ino) == (1, inode)
    assert set(tmp_path.iterdir()) == {path, path.with_suffix(".crc32")}


def test_the_file_is_mapped_not_loaded(table):
    assert type(table.values) is np.ndarray  # a memmap is slower to slice
    assert isinstance(table.values.base, np.memmap)
    assert not table.values.flags.writeable


def _truncate(path):
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)


def _cut_inside_a_number(path):
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - 1)


def _lengthen(path):
    with path.open("ab") as file:
        file.write(b"\0\0\0\0")


def _empty(path):
    path.write_bytes(b"")


def _zero_beginning(path):
    with path.open("r+b") as file:
        file.write(bytes(40))


def _zero_end(path):
    with path.open("r+b") as file:
        file.seek(-40, io.SEEK_END)
        file.write(bytes(40))


def _flip_a_bit_in_the_middle(path):
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2 + 20_000)
        byte = file.read(1)[0]
        file.seek(-1, io.SEEK_CUR)
        file.write(bytes([byte ^ 1]))


def _lose_the_checksums(path):
    path.with_suffix(".crc32").unlink()


def _cut_the_checksums(path):
    _cut_inside_a_number(path.with_suffix(".crc32"))


DAMAGES = [
    _truncate,
    _cut_inside_a_number,
    _lengthen,
    _empty,
    _zero_beginning,
    _zero_end,
    _flip_a_bit_in_the_middle,
    _lose_the_checksums,
    _cut_the_checksums,
]


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("size", [20_000, BLOCK + 3000])
def test_a_damaged_file_is_built_again(tmp_path, content, damage, size):
    path = NoiseTable.open(size, directory=tmp_path).path
    damage(path)
    again = NoiseTable.open(size, directory=tmp_path)
    assert np.array_equal(again.values, content[:size])
    sums = path.with_suffix(".crc32")
    assert set(tmp_path.iterdir()) == {path, sums}
    data = path.read_bytes()
    blocks = [data[first : first + 4 * BLOCK] for first in range(0, len(data), 4 * BLOCK)]
    assert np.fromfile(sums, "<u4").tolist() == [zlib.crc32(block) for block in blocks]


def test_a_table_of_other_numbers_with_checksums_of_its_own_is_built_again(tmp_path, content):
    other = NoiseTable.open(3000, 7, directory=tmp_path).path
    for suffix in (".f32", ".crc32"):
        other.with_suffix(suffix).rename(tmp_path / f"noise-v1-3000-{NOISE_SEED}{suffix}")
    assert np.array_equal(NoiseTable.open(3000, directory=tmp_path).values, content[:3000])


def test_a_damaged_end_is_found_wherever_the_last_block_ends(tmp_path, content):
    path = NoiseTable.open(10_000, directory=tmp_path).path
    _zero_end(path)
    assert np.array_equal(NoiseTable.open(10_000, directory=tmp_path).values, content[:10_000])


def test_processes_that_have_the_old_file_open_keep_its_numbers(tmp_path, content):
    old = NoiseTable.open(2000, directory=tmp_path)
    with old.path.open("ab") as file:
        file.write(b"\0\0\0\0")
    NoiseTable.open(2000, directory=tmp_path)
    assert np.array_equal(old.values, content[:2000])


def _full_disk(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_leaves_nothing_behind_and_names_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setattr(storage.os, "fsync", _full_disk)
    with pytest.raises(StorageError, match=r"the disk is full.*SHES_CACHE_DIR.*--noise-table-size") as raised:
        NoiseTable.open(5000, directory=tmp_path)
    assert str(tmp_path) in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_rename_leaves_nothing_behind(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(storage.Path, "replace", refuse)
    with pytest.raises(StorageError, match="cannot write"):
        NoiseTable.open(5000, directory=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_rebuild_leaves_the_old_file_as_it_was(tmp_path, monkeypatch):
    path = NoiseTable.open(5000, directory=tmp_path).path
    path.write_bytes(b"old")
    monkeypatch.setattr(storage.os, "fsync", _full_disk)
    with pytest.raises(StorageError):
        NoiseTable.open(5000, directory=tmp_path)
    assert path.read_bytes() == b"old"
    assert set(tmp_path.iterdir()) == {path, path.with_suffix(".crc32")}


@pytest.mark.parametrize(("size", "what"), [("memory", "of memory"), ("disk", "on the disk of .*")])
def test_a_table_that_does_not_fit_is_refused_with_the_size_that_would(tmp_path, monkeypatch, size, what):
    monkeypatch.setattr(noise, f"free_{size}", lambda *_: 4 * 2_500_000)
    with pytest.raises(
        ConfigError,
        match=rf"noise_table_size is 3,000,000, which takes 12\.0 MB, but 10\.0 MB {what} are free\. "
        r"Set --noise-table-size 2500000 at most, or point SHES_CACHE_DIR",
    ):
        NoiseTable.open(3_000_000, directory=tmp_path / "cache")
    assert list(tmp_path.iterdir()) == []
    NoiseTable.open(2_500_000, directory=tmp_path / "cache")


def test_where_no_table_fits_no_size_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(noise, "free_disk", lambda _: 0)
    with pytest.raises(
        ConfigError, match=r"0\.0 MB on the disk of .* are free\. Point SHES_CACHE_DIR at a larger disk"
    ):
        NoiseTable.open(5000, directory=tmp_path / "cache")


def test_a_table_that_is_there_needs_no_free_disk(tmp_path, monkeypatch):
    NoiseTable.open(5000, directory=tmp_path)
    monkeypatch.setattr(noise, "free_disk", lambda *_: 0)
    assert NoiseTable.open(5000, directory=tmp_path).size == 5000


BUILDER = """
import os, sys
from pathlib import Path
from shes.es import noise
def stop(*_):
    print("builds", flush=True)
    sys.stdin.read()
original, noise._block = noise._block, stop
noise.NoiseTable.open(5000, directory=Path(sys.argv[1]))
"""


def test_the_unfinished_file_of_a_killed_builder_goes_with_the_next_table_of_any_size(tmp_path):
    builder = subprocess.Popen(
        [sys.executable, "-c", BUILDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert builder.stdout.readline() == b"builds\n"
    (part,) = tmp_path.glob(".*.part")
    NoiseTable.open(100, directory=tmp_path)
    assert part.exists()  # its writer is at work
    builder.kill()
    builder.communicate()
    NoiseTable.open(100, directory=tmp_path)  # it is there already
    assert sorted(path.name for path in tmp_path.iterdir()) == ["noise-v1-100-123.crc32", "noise-v1-100-123.f32"]


def test_an_interrupted_build_leaves_nothing_behind(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(noise, "_block", interrupt)
    with pytest.raises(KeyboardInterrupt):
        NoiseTable.open(5000, directory=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_cache_folder_that_is_a_file_is_a_storage_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="SHES_CACHE_DIR"):
        NoiseTable.open(100, directory=tmp_path / "file")


def test_the_cache_folder_is_made_where_it_is_missing(tmp_path):
    assert NoiseTable.open(100, directory=tmp_path / "a" / "b").path.parent == tmp_path / "a" / "b"


def test_workers_open_the_same_file(table):
    other = NoiseTable.open_file(table.path)
    assert other.path == table.path
    assert np.array_equal(other.values, table.values)
    assert not other.values.flags.writeable


def test_a_missing_file_is_a_storage_error_for_a_worker(tmp_path):
    with pytest.raises(StorageError, match=r"nothing\.f32 cannot be opened.*Start the run again"):
        NoiseTable.open_file(tmp_path / "nothing.f32")


@pytest.mark.parametrize("size", [0, -5])
def test_a_size_that_is_not_positive_is_refused(tmp_path, size):
    with pytest.raises(
        ConfigError, match=rf"size must be a whole number of at least 1, got {size}.*--noise-table-size"
    ):
        NoiseTable.open(size, directory=tmp_path)


def test_a_table_needs_twice_the_parameters_of_a_level():
    table = NoiseTable(np.zeros(2000, np.float32))
    table.check_dim(1000)
    with pytest.raises(ConfigError, match=r"is 2,000.* 1,001 parameters.* at least 2,002.*--noise-table-size"):
        table.check_dim(1001)


def test_the_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "own"))
    assert default_cache_dir() == tmp_path / "own"
    assert NoiseTable.open(10).path.parent == tmp_path / "own"
    monkeypatch.delenv("SHES_CACHE_DIR")
    assert default_cache_dir() == tmp_path / "xdg" / "shes"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_cache_dir() == tmp_path / "home" / ".cache" / "shes"

    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    with pytest.raises(ConfigError, match=r"no place for the cached noise table: .* Set SHES_CACHE_DIR to a folder"):
        default_cache_dir()


def test_a_file_that_was_taken_for_abandoned_before_it_was_locked_is_begun_again(tmp_path, monkeypatch):
    flock, calls = storage.fcntl.flock, []

    def unlink_first(file, operation):
        if not calls:
            (part,) = tmp_path.glob(".*.part")
            part.unlink()  # as another process does that holds its lock for a moment
        calls.append(operation)
        flock(file, operation)

    monkeypatch.setattr(storage.fcntl, "flock", unlink_first)
    storage.write_atomically(tmp_path / "a", lambda file: file.write(b"all"))
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"all")]
    assert len(calls) == 2


def test_an_abandoned_file_is_removed_where_a_lock_needs_a_file_that_is_open_for_writing(tmp_path, monkeypatch):
    """As over NFS, where byte ranges are locked instead."""
    flock = storage.fcntl.flock

    def of_nfs(file, operation):
        if not file.writable():
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        flock(file, operation)

    monkeypatch.setattr(storage.fcntl, "flock", of_nfs)
    (tmp_path / ".a.1.2.part").write_bytes(b"half")
    storage.write_atomically(tmp_path / "a", lambda file: file.write(b"all"))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_machine_that_lacks_the_file_generates_the_same_table_once_in_its_own_cache(tmp_path, monkeypatch):
    there = NoiseTable.open(5000, directory=tmp_path / "there")
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "here"))
    assert NoiseTable.open_copy(there.path).path == there.path
    built, build = [], NoiseTable._build
    monkeypatch.setattr(NoiseTable, "_build", staticmethod(lambda *args: built.append(args) or build(*args)))
    there.path.unlink()
    with ThreadPoolExecutor(4) as pool:
        copies = list(pool.map(NoiseTable.open_copy, [there.path] * 8))
    assert len(built) == 1
    assert {copy.path for copy in copies} == {tmp_path / "here" / there.path.name}
    np.testing.assert_array_equal(copies[0].values, there.values)


@pytest.mark.parametrize("damage", [lambda old: old[:-4], lambda old: b"\1" + old[1:]])
def test_a_machine_whose_file_is_of_another_length_or_beginning_does_not_use_it(tmp_path, monkeypatch, damage):
    there = NoiseTable.open(5000, directory=tmp_path / "there")
    expected = there.values.copy()
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "here"))
    there.path.write_bytes(damage(there.path.read_bytes()))
    copy = NoiseTable.open_copy(there.path)
    assert copy.path.parent == tmp_path / "here"
    np.testing.assert_array_equal(copy.values, expected)
