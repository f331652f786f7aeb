"""The noise table and the gradient estimate, a weighted sum of its slices.

The table is a file of standard normals and their CRC-32, memory-mapped and shared by all processes of a machine. It is
generated once from its seed, written atomically, and cached between runs. A perturbation is sent as one integer, the
start of a slice.

Source: Salimans et al. 2017, section 2.1; SHES paper II-A, and Algorithm 1 lines 4 and 5.
"""

from __future__ import annotations

import fcntl
import os
import re
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import IO, Annotated, Any
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
_FORMAT = 2  # part of the file name; increase it if the numbers or the layout ever change
_NAME = re.compile(rf"noise-v{_FORMAT}-(\d+)-{NOISE_SEED}\.f32")  # of a table's file, with its size
_BLOCK = 1 << 20  # normals drawn at a time
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


def _blocks(size: int) -> Iterator[bytes]:
    """Yield the normals of a table, each block from a random stream of its own."""
    for number, start in enumerate(range(0, size, _BLOCK)):
        yield table_stream(NOISE_SEED, number).standard_normal(min(_BLOCK, size - start), dtype=np.float32).tobytes()


def _path(size: int) -> Path:
    return default_cache_dir() / f"noise-v{_FORMAT}-{size}-{NOISE_SEED}.f32"


class NoiseTable:
    """Read-only float32 standard normals in a memory-mapped file."""

    def __init__(self, values: F32Array, path: Path | None = None, xp: ModuleType = np) -> None:
        """Wrap `values` [size], an array of `xp`. `NoiseTable.open` opens the shared file."""
        self.values = values
        self.path = path
        self.xp = xp
        """Array module of the values."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle a table as the path of its file."""
        return (NoiseTable, (to_host(self.values),)) if self.path is None else (NoiseTable.open_copy, (self.path,))

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

    @classmethod
    @checked
    def open(cls, size: Annotated[int, Ge(1), Shown(flag="--noise-table-size")], dim: int = 0) -> NoiseTable:
        """Open the cached table of `size` normals. If its file is missing or damaged, generate it first.

        Raise ConfigError if the table has less than twice the `dim` normals of a noise vector, or fits neither the
        memory nor the disk; StorageError if it cannot be written.
        """
        if size < 2 * dim:
            raise ConfigError(
                f"noise_table_size is {size:,}, but a level has {dim:,} parameters and needs at least {2 * dim:,}. "
                "Raise --noise-table-size."
            )
        path = _path(size)
        remove_abandoned(path.parent, "noise-*")  # of tables of any size, whose builders were killed
        if not _is_intact(path, size):
            cls.check_room(size)
            _build(path, size)
        return cls._map(path)

    @classmethod
    def open_copy(cls, path: Path) -> NoiseTable:
        """Map the table file at `path`, as worker processes do.

        A machine that lacks the file, or has one of another length or beginning, uses the same table in its own cache
        folder, generated by the first worker there. The CRC is left to the main process.
        """
        named = _NAME.fullmatch(path.name)
        if named is None or _is_intact(path, int(named[1]), has_crc=False):
            return cls._map(path)
        folder = default_cache_dir()
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(folder, os.O_RDONLY)
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX)
            return cls.open(int(named[1]))
        finally:
            os.close(lock)

    @classmethod
    def _map(cls, path: Path) -> NoiseTable:
        try:
            # As a plain array: a memmap is slower to slice, and an update slices it for every group and block.
            return cls(np.asarray(np.memmap(path, dtype=np.float32, mode="r"))[:-1], path)
        except (OSError, ValueError) as error:
            raise StorageError(f"the noise table {path} cannot be opened: {error}. Start the run again.") from error

    @staticmethod
    def check_room(size: int) -> None:
        """Raise ConfigError unless the table of `size` normals is there or fits the memory and the disk."""
        path = _path(size)
        if path.exists():
            return
        for free, where in ((free_memory(), "of memory"), (free_disk(path), f"on the disk of {path.parent}")):
            if 4 * size > free:
                raise ConfigError(
                    f"noise_table_size is {size:,}, which takes {4 * size / 1e6:,.0f} MB, but {free / 1e6:,.0f} MB "
                    f"{where} are free. Set --noise-table-size {free // 4} at most, or SHES_CACHE_DIR to a larger disk."
                )


def _is_intact(path: Path, size: int, *, has_crc: bool = True) -> bool:
    """Return whether the file has the right length and beginning and, unless `has_crc` is false, the right CRC."""
    try:
        content = np.memmap(path, dtype=np.uint32, mode="r")
    except (OSError, ValueError):
        return False
    beginning = next(_blocks(min(_CHECKED, size)))
    is_table = len(content) == size + 1 and content[:_CHECKED].tobytes().startswith(beginning)
    return is_table and (not has_crc or zlib.crc32(content[:-1].data) == content[-1])


def _build(path: Path, size: int) -> None:
    """Generate the table and move it into place, so that no process ever sees an unfinished file."""

    def write(file: IO[bytes]) -> None:
        crc = 0
        for block in _blocks(size):
            file.write(block)
            crc = zlib.crc32(block, crc)
        file.write(np.uint32(crc).tobytes())

    try:
        with storage_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, write)
    except StorageError as error:
        raise StorageError(
            f"the noise table ({4 * size / 1e6:,.0f} MB) cannot be kept in {path.parent}: {error.__cause__}. "
            "Set SHES_CACHE_DIR to a folder that you may write to, with room, or lower --noise-table-size."
        ) from error


_COPIES: WeakValueDictionary[tuple[str, Path | int], NoiseTable] = WeakValueDictionary()
"""Tables on devices, by module and file. A table may have a gigabyte, so rollout and update share the copy."""


def weighted_noise_sum(
    table: NoiseTable, noise_index: IntArray, weights: F32Array, dim: int, pool: ThreadPoolExecutor | None = None
) -> F32Array:
    """Return `sum_g weights[g] * noise(noise_index[g])` [dim], over groups: their members share a noise vector.

    The result is bit-identical for any number of threads and on any processor or GPU: columns are cut into fixed
    blocks, and each block is summed group by group with elementwise operations, without BLAS.

    Args:
        table: The noise table. The sum is computed on its device.
        noise_index: Start of each group's slice [G].
        weights: Weight of each group [G]. The noise of a group of weight zero is not read.
        dim: Number of parameters of the level.
        pool: Threads that share the blocks; None uses the calling thread.
    """
    total = table.xp.zeros(dim, dtype=np.float32)
    groups = [(int(noise_index[g]), np.float32(weights[g])) for g in np.flatnonzero(weights)]

    def sum_columns(start: int, number: int = _COLUMNS) -> None:
        out = total[start : start + number]
        product = np.empty_like(out)
        for index, weight in groups:
            np.multiply(table.values[index + start : index + start + len(out)], weight, out=product)
            np.add(out, product, out=out)

    if table.xp is not np:  # one block: a GPU has its own threads, and those of the pool would use another stream
        sum_columns(0, dim)
        return to_host(total)
    list((map if pool is None else pool.map)(sum_columns, range(0, dim, _COLUMNS)))
    return total
