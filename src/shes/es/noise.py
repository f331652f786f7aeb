"""The noise table and the gradient estimate, a weighted sum of its slices.

The table is a file of standard normals, memory-mapped and shared by all processes of a machine. It is generated once
from its seed, written atomically, and cached between runs. A perturbation is sent as one integer, the start of a slice.

Source: Salimans et al. 2017, section 2.1; SHES paper II-A, and Algorithm 1 lines 4 and 5.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import IO, Annotated
from weakref import WeakValueDictionary

import numpy as np

from shes.errors import ConfigError, StorageError
from shes.machine import free_disk, free_memory
from shes.settings import Ge, Shown, checked
from shes.storage import remove_abandoned, storage_errors, write_atomically
from shes.streams import table_stream
from shes.types import F32Array, IntArray, to_host

NOISE_SEED = 123
"""Seed of the table, as in the authors' code."""
DEFAULT_TABLE_SIZE = 25_000_000
"""Normals in the table of a run without a setting for it."""
_FORMAT = 1  # part of the file name; increase it if the numbers ever change
_NAME = re.compile(rf"noise-v{_FORMAT}-(\d+)-(\d+)\.f32")  # of a table's file: size and seed
_BLOCK = 1 << 20  # normals drawn at a time; each block has its own random stream
_CHECKED = 4096  # normals generated again when a cached file is opened
_COLUMNS = 65536  # parameters summed at a time: enough that two threads do not wait for Python's lock


def default_cache_dir() -> Path:
    """Return `$SHES_CACHE_DIR`, else `$XDG_CACHE_HOME/shes`, else `~/.cache/shes`; raise ConfigError without a home."""
    if own := os.environ.get("SHES_CACHE_DIR"):
        return Path(own)
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "shes"
    try:
        return Path.home() / ".cache" / "shes"
    except RuntimeError as error:
        raise ConfigError(
            f"there is no place for the cached noise table: {error} Set SHES_CACHE_DIR to a folder for it."
        ) from error


@contextmanager
def _one_process_at_a_time(folder: Path) -> Generator[None]:
    """Lock `folder` for the block. Without file locks this has no effect."""
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _block(seed: int, number: int, length: int) -> F32Array:
    return table_stream(seed, number).standard_normal(length, dtype=np.float32)


def _path(size: int, seed: int = NOISE_SEED, directory: Path | None = None) -> Path:
    return (default_cache_dir() if directory is None else directory) / f"noise-v{_FORMAT}-{size}-{seed}.f32"


def _in_words(num_bytes: int) -> str:
    return f"{num_bytes / 1e9:,.1f} GB" if num_bytes >= 1e8 else f"{num_bytes / 1e6:,.1f} MB"


class NoiseTable:
    """Read-only float32 standard normals in a memory-mapped file."""

    def __init__(self, values: F32Array, path: Path | None = None, xp: ModuleType = np) -> None:
        """Wrap `values` [size], an array of `xp`. `NoiseTable.open` opens the shared file."""
        self.values = values
        self.path = path
        self.xp = xp
        """Array module of the values."""

    @property
    def size(self) -> int:
        """Number of normals in the table."""
        return int(self.values.shape[0])

    def on(self, xp: ModuleType) -> NoiseTable:
        """Return this table as an array of `xp`: itself for NumPy, else the only copy on the device."""
        if xp is np:
            return self
        place = (xp.__name__, self.path or id(self))
        copy = _COPIES.get(place)
        if copy is None:
            copy = _COPIES[place] = NoiseTable(xp.asarray(self.values), self.path, xp)
        return copy

    def slice(self, index: int, dim: int) -> F32Array:
        """Return the noise vector [dim] that starts at `index`, as a view."""
        return self.values[index : index + dim]

    def check_dim(self, dim: int) -> None:
        """Raise ConfigError unless the table holds at least `2 * dim` normals, for vectors of `dim` parameters."""
        if self.size < 2 * dim:
            raise ConfigError(
                f"noise_table_size is {self.size:,}, but a level has {dim:,} parameters and needs at least "
                f"{2 * dim:,}. Raise --noise-table-size."
            )

    @classmethod
    @checked
    def open(
        cls,
        size: Annotated[int, Ge(1), Shown(flag="--noise-table-size")],
        seed: int = NOISE_SEED,
        directory: Path | None = None,
    ) -> NoiseTable:
        """Open the cached table of `size` normals from `seed`. If its file is missing or damaged, generate it first.

        The file's length and its first normals are checked.

        Raises:
            ConfigError: `size` is not positive, or the table fits neither the memory nor the disk.
            StorageError: The cache folder cannot be written.
        """
        path = _path(size, seed, directory)
        remove_abandoned(path.parent, "noise-*")  # of tables of any size, whose builders were killed
        if not cls._is_intact(path, size, seed):
            cls._check_room(path, size)
            cls._build(path, size, seed)
        return cls._map(path)

    @classmethod
    def open_copy(cls, path: Path) -> NoiseTable:
        """Map the table file at `path`, as worker processes do.

        A machine that lacks the file, or has one of another length or beginning, uses the same table in its own cache
        folder, generated by the first worker there.

        Raises:
            StorageError: The file is missing and not named as a table, or the cache folder cannot be written.
            ConfigError: The table fits neither the memory nor the disk of this machine.
        """
        named = _NAME.fullmatch(path.name)
        if named is None or cls._is_intact(path, int(named[1]), int(named[2])):
            return cls._map(path)
        with _one_process_at_a_time(default_cache_dir()):
            return cls.open(int(named[1]), int(named[2]))

    @classmethod
    def _map(cls, path: Path) -> NoiseTable:
        try:
            # As a plain array: a memmap is slower to slice, and an update slices it for every group and block.
            return cls(np.asarray(np.memmap(path, dtype=np.float32, mode="r")), path)
        except (OSError, ValueError) as error:
            raise StorageError(f"the noise table {path} cannot be opened: {error}. Start the run again.") from error

    @staticmethod
    def _is_intact(path: Path, size: int, seed: int) -> bool:
        """Return whether the file has the right length and beginning."""
        try:
            with path.open("rb", buffering=0) as file:
                head = file.read(4 * min(_CHECKED, size))
                length = os.fstat(file.fileno()).st_size
        except OSError:
            return False
        return length == 4 * size and head == _block(seed, 0, min(_CHECKED, size)).tobytes()

    @classmethod
    def check_room(cls, size: int) -> None:
        """Raise ConfigError unless the table of `size` normals exists or fits the memory and the disk."""
        path = _path(size)
        if not path.exists():
            cls._check_room(path, size)

    @staticmethod
    def _check_room(path: Path, size: int) -> None:
        for free, where in ((free_memory(), "of memory"), (free_disk(path), f"on the disk of {path.parent}")):
            if 4 * size > free:
                raise ConfigError(
                    f"noise_table_size is {size:,}, which takes {_in_words(4 * size)}, but {_in_words(free)} {where} "
                    f"are free. Set --noise-table-size {free // 4} at most, or point SHES_CACHE_DIR at a larger disk."
                )

    @staticmethod
    def _build(path: Path, size: int, seed: int) -> None:
        """Generate the table and move it into place, so that no process ever sees an unfinished file."""

        def write(file: IO[bytes]) -> None:
            for number in range(-(-size // _BLOCK)):
                file.write(_block(seed, number, min(_BLOCK, size - number * _BLOCK)).tobytes())

        try:
            with storage_errors(path):
                path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, write)
        except StorageError as error:
            raise StorageError(
                f"the noise table ({_in_words(4 * size)}) cannot be kept: {error} "
                "Point SHES_CACHE_DIR at a folder with room, or lower --noise-table-size."
            ) from error


_COPIES: WeakValueDictionary[tuple[str, Path | int], NoiseTable] = WeakValueDictionary()
"""Tables on devices, by module and file. A table may have a gigabyte, so rollout and update share the copy."""


def weighted_noise_sum(
    table: NoiseTable, noise_index: IntArray, weights: F32Array, dim: int, pool: ThreadPoolExecutor | None = None
) -> F32Array:
    """Return `sum_g weights[g] * noise(noise_index[g])` [dim].

    The result is bit-identical for any number of threads and on any processor or GPU: columns are cut into fixed
    blocks, and each block is summed group by group with elementwise operations, without BLAS. The members of a group
    share a noise vector, so the sum runs over groups instead of members.

    Args:
        table: The noise table. The sum is computed on its device.
        noise_index: Start of each group's slice [G].
        weights: Weight of each group [G]. The noise of a group of weight zero is not read.
        dim: Number of parameters of the level.
        pool: Threads that share the blocks; None uses the calling thread.
    """
    total = table.xp.zeros(dim, dtype=np.float32)
    groups = [(int(noise_index[g]), np.float32(weights[g])) for g in np.flatnonzero(weights)]

    def sum_block(start: int) -> None:
        _sum_columns(table.values, groups, start, total[start : start + _COLUMNS])

    if table.xp is not np:  # one block: a GPU has its own threads, and those of the pool would use another stream
        _sum_columns(table.values, groups, 0, total)
        return to_host(total)
    list((map if pool is None else pool.map)(sum_block, range(0, dim, _COLUMNS)))
    return total


def _sum_columns(values: F32Array, groups: list[tuple[int, np.float32]], start: int, out: F32Array) -> None:
    """Add every group's weighted noise of the columns from `start` on to `out` [columns]."""
    product = np.empty_like(out)
    for index, weight in groups:
        begin = index + start
        np.multiply(values[begin : begin + len(out)], weight, out=product)
        np.add(out, product, out=out)
