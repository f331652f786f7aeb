"""The noise table: its numbers, the file that holds them, and the weighted sum of its slices."""

import copy
import os
import pickle
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from shes.errors import ConfigError, StorageError
from shes.es import noise
from shes.es.noise import NoiseTable, default_cache_dir, weighted_noise_sum
from shes.storage import can_lock
from tests.messages import raises

BLOCK = 1 << 20
DIM = 140_000  # three blocks of columns in a sum, the last one short


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(BLOCK + 3000)


@pytest.fixture(scope="module")
def content(table):
    return np.fromfile(table.path, dtype="<f4")[:-1]  # the last four bytes are the CRC


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache folder."""
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_slice_is_a_read_only_view_of_the_file(table, content):
    for index, dim in ((0, 1), (7, 5000), (table.size - 9, 9)):
        vector = table.slice(index, dim)
        assert vector.tobytes() == content[index : index + dim].tobytes()
        assert np.shares_memory(vector, table.values)
    assert type(table.values) is np.ndarray  # a memmap is slower to slice
    with pytest.raises(ValueError, match="read-only"):
        vector[0] = 1


@pytest.mark.parametrize("size", [1, 7, 4096, 4097, 50_000, BLOCK + 9000])
def test_tables_of_any_size_have_a_common_beginning(cache, content, size):
    again, common = NoiseTable.open(size), min(size, len(content))
    assert again.size == size
    assert np.array_equal(again.values[:common], content[:common])


def test_the_first_numbers_of_the_table_never_change(content):
    # A change here changes the results of every run: give the file another name, and say so in the CHANGELOG.
    assert content[:4] == pytest.approx([-1.0154525, -0.46104807, -0.042525586, 0.95501006], rel=1e-6)
    assert content[BLOCK : BLOCK + 4] == pytest.approx([-0.67301446, 0.47767088, -0.0903391, -0.45826763], rel=1e-6)


def test_opening_again_does_not_write_the_file(cache):
    path = NoiseTable.open(9000).path
    os.utime(path, ns=(1, 1))
    inode = path.stat().st_ino
    assert NoiseTable.open(9000, 4500).size == 9000
    assert (path.stat().st_mtime_ns, path.stat().st_ino) == (1, inode)
    assert list(cache.iterdir()) == [path]


DAMAGES = {
    "empty": lambda data: data[:0],
    "cut inside a number": lambda data: data[:-1],
    "a number too short": lambda data: data[:-4],
    "longer": lambda data: data + bytes(4),
    "other numbers": lambda data: (normals := bytes(4) + data[4:-4]) + zlib.crc32(normals).to_bytes(4, "little"),
    "another byte in the middle": lambda data: data[:40_000] + bytes([data[40_000] ^ 1]) + data[40_001:],
    "another last byte": lambda data: data[:-1] + bytes([data[-1] ^ 1]),
    "another first byte": lambda data: bytes([data[0] ^ 1]) + data[1:],
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_replaced_and_not_overwritten(cache, content, damage):
    path = NoiseTable.open(20_000).path
    path.write_bytes(damage(path.read_bytes()))
    with path.open("rb") as old:  # as a process has it that runs
        before = path.read_bytes()
        assert np.array_equal(NoiseTable.open(20_000).values, content[:20_000])
        assert old.read() == before
    assert list(cache.iterdir()) == [path]


def test_the_next_table_removes_a_killed_builders_file(cache):
    cache.mkdir()
    part = cache / ".noise-v2-5000-123.f32.77.1.part"
    with part.open("wb") as file:
        assert can_lock(file)
        NoiseTable.open(100)
        assert part.exists()  # its writer is at work
    NoiseTable.open(100)
    assert [path.name for path in cache.iterdir()] == ["noise-v2-100-123.f32"]


@pytest.mark.parametrize(("kind", "where"), [("memory", "of memory"), ("disk", "on the disk of ... ")])
def test_a_table_that_does_not_fit_is_refused(cache, monkeypatch, kind, where):
    monkeypatch.setattr(noise, f"free_{kind}", lambda *_: 4 * 250_000_000)
    message = (
        f"noise_table_size is 250,000,001, which takes 1,000 MB, but 1,000 MB {where} are free. "
        "Set --noise-table-size 250000000 at most, or SHES_CACHE_DIR to a larger disk"
    )
    for call in (NoiseTable.open, NoiseTable.check_room):
        with raises(ConfigError, message):
            call(250_000_001)
    assert not cache.exists()
    NoiseTable.check_room(250_000_000)
    NoiseTable.open(9000)
    monkeypatch.setattr(noise, f"free_{kind}", lambda *_: 0)
    NoiseTable.check_room(9000)  # it is there already
    assert NoiseTable.open(9000).size == 9000


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: NoiseTable.open(0), ConfigError, "at least 1, got 0 ... --noise-table-size"),
        (lambda: NoiseTable.open(100), StorageError, "kept in ... /cache: ... SHES_CACHE_DIR to a folder that"),
        (lambda: NoiseTable.open_copy(Path("no.f32")), StorageError, "no.f32 cannot be opened ... Start the run again"),
    ],
)
def test_what_cannot_be_opened_is_refused(cache, call, error, message):
    cache.write_text("")  # a file is in the way
    with raises(error, message):
        call()


def test_the_cache_folder_follows_the_environment(monkeypatch):
    for name, value in {"SHES_CACHE_DIR": "/own", "XDG_CACHE_HOME": "/xdg", "HOME": "/home"}.items():
        monkeypatch.setenv(name, value)
    for folder, name in (("/own", "SHES_CACHE_DIR"), ("/xdg/shes", "XDG_CACHE_HOME"), ("/home/.cache/shes", "HOME")):
        assert default_cache_dir() == Path(folder)
        monkeypatch.delenv(name)

    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    with raises(ConfigError, "no place for the cached noise table: ... Set SHES_CACHE_DIR to a folder"):
        default_cache_dir()


@pytest.mark.parametrize("damage", [None, "a number too short", "another first byte"])
def test_a_machine_without_the_file_generates_it_once(tmp_path, monkeypatch, content, damage):
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "there"))
    there = NoiseTable.open(5000).path
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "here"))
    assert NoiseTable.open_copy(there).path == there
    if damage:
        there.write_bytes(DAMAGES[damage](there.read_bytes()))
    else:
        there.unlink()
    built, fsync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: built.append(file) or fsync(file))
    with ThreadPoolExecutor(4) as pool:
        copies = list(pool.map(NoiseTable.open_copy, [there] * 8))
    assert len(built) == 1
    assert {copy.path for copy in copies} == {tmp_path / "here" / there.name}
    assert np.array_equal(copies[0].values, content[:5000])


@pytest.mark.parametrize("threads", [None, 1, 2, 5])
@pytest.mark.parametrize("dim", [1, 65_535, 65_536, 65_537, DIM])
def test_sums_are_bit_identical_for_any_threads_and_width(table, threads, dim):
    rng, expected = np.random.default_rng(1), np.zeros(dim, np.float32)
    drawn = rng.integers(0, table.size - DIM + 1, 20), rng.normal(size=20).astype(np.float32)
    for start, weight in zip(*drawn, strict=True):  # the order that every block keeps
        expected += weight * table.values[start : start + dim]
    with ThreadPoolExecutor(threads or 1) as pool:
        total = weighted_noise_sum(table, *drawn, dim, pool if threads else None)
    assert total.tobytes() == expected.tobytes()


def test_groups_of_weight_zero_are_not_read():
    values = np.ones(1000, np.float32)
    values[:100] = np.nan
    index, weights = np.array([0, 200, 10, 950]), np.array([0, 2, -0.0, 3], np.float32)
    assert np.all(weighted_noise_sum(NoiseTable(values), index, weights, 50) == 5)  # the last slice is whole
    assert not weighted_noise_sum(NoiseTable(values), index, np.zeros(4, np.float32), 50).any()


@pytest.mark.parametrize("do", [copy.deepcopy, lambda table: pickle.loads(pickle.dumps(table))])  # noqa: S301 - its own
def test_a_copy_of_a_table_maps_the_same_file(table, do):
    assert do(table).path == table.path
    assert np.array_equal(do(table).values, table.values)
    assert do(NoiseTable(np.ones(3, np.float32))).values.tolist() == [1, 1, 1]
