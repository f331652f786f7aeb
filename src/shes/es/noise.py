"""The noise table: a file of standard normals, memory-mapped and shared by all processes of a machine.

A perturbation is sent as one integer, the start of a slice of the table (Salimans et al. 2017, section 2.1; SHES paper
II-A). The file is generated once from its seed, written atomically, and cached between runs. A file of checksums lies
beside it, one for every block of a million normals.
"""

from __future__ import annotations

import fcntl
import os
import re
import zlib
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import IO, Annotated
from weakref import WeakValueDictionary

import numpy as np

from shes.checked import checked
from shes.errors import ConfigError, StorageError
from shes.machine import free_disk, free_memory
from shes.settings import Ge, Shown
from shes.storage import remove_abandoned, storage_errors, write_atomically
from shes.types import F32Array

NOISE_SEED = 123
"""Seed of the table, as in the authors' code."""
DEFAULT_TABLE_SIZE = 25_000_000
"""Normals in the table of a run without a setting for it."""
_FORMAT = 1  # part of the file name; increase it if the numbers ever change
_NAME = re.compile(rf"noise-v{_FORMAT}-(\d+)-(\d+)\.f32")  # of a table's file: size and seed
_BLOCK = 1 << 20  # normals drawn at a time; each block has its own random stream
_CHECKED = 4096  # normals generated again when a cached file is opened


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
def _alone(folder: Path) -> Generator[None]:
    """Let one process of this machine at a time into the block. A file system without locks lets in all."""
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
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number,))))
    return rng.standard_normal(length, dtype=np.float32)


def _path(size: int, seed: int = NOISE_SEED, directory: Path | None = None) -> Path:
    """Return the file of the table of `size` normals from `seed`."""
    return (default_cache_dir() if directory is None else directory) / f"noise-v{_FORMAT}-{size}-{seed}.f32"


def _in_words(size: int) -> str:
    """Return a number of bytes in GB, or in MB if it is small."""
    return f"{size / 1e9:,.1f} GB" if size >= 1e8 else f"{size / 1e6:,.1f} MB"


def _checksums(path: Path) -> Path:
    """Return the file with the checksum (CRC-32) of every block of the table at `path`."""
    return path.with_suffix(".crc32")


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

        The checksums of all blocks are checked, once for every run. With the file in the system's cache this takes 0.05
        seconds of one core for 25 million normals (100 MB) and 0.5 for 250 million (1 GB), a twelfth of the time to
        generate them; without, the time to read the file. Worker processes map the file without another check.

        Raises:
            ConfigError: `size` is not positive, or the table fits neither the memory nor the disk.
            StorageError: The cache folder cannot be written.
        """
        path = _path(size, seed, directory)
        remove_abandoned(path.parent, "noise-*")  # of tables of any size, whose builders were killed
        if not cls._is_intact(path, size, seed):
            cls._check_room(path, size)
            cls._build(path, size, seed)
        return cls.open_file(path)

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
        if named is None:
            return cls.open_file(path)
        size, seed = int(named[1]), int(named[2])
        if cls._begins_right(path, size, seed):
            return cls.open_file(path)
        with _alone(default_cache_dir()):  # the others wait for the table, which every one of them checks
            return cls.open(size, seed)

    @classmethod
    def open_file(cls, path: Path) -> NoiseTable:
        """Map an existing table file, as worker processes do; raise StorageError if it is missing."""
        try:
            # As a plain array: a memmap is slower to slice, and an update slices it for every group and block.
            return cls(np.asarray(np.memmap(path, dtype=np.float32, mode="r")), path)
        except (OSError, ValueError) as error:
            raise StorageError(f"the noise table {path} cannot be opened: {error}. Start the run again.") from error

    @staticmethod
    def _begins_right(path: Path, size: int, seed: int) -> bool:
        """Return whether the file has the right length and beginning."""
        try:
            with path.open("rb", buffering=0) as file:
                head = file.read(4 * min(_CHECKED, size))
                length = os.fstat(file.fileno()).st_size
        except OSError:
            return False
        return length == 4 * size and head == _block(seed, 0, min(_CHECKED, size)).tobytes()

    @classmethod
    def _is_intact(cls, path: Path, size: int, seed: int) -> bool:
        """Return whether the file has the right length, beginning and checksums."""
        if not cls._begins_right(path, size, seed):
            return False
        try:
            sums = np.fromfile(_checksums(path), dtype="<u4")
            with path.open("rb", buffering=0) as file:
                # Read, not mapped: a disk that fails is then an error, not the end of the process.
                found = [zlib.crc32(block) for block in iter(lambda: file.read(4 * _BLOCK), b"")]
        except OSError:
            return False
        return np.array_equal(sums, found)

    @classmethod
    def check_room(cls, size: int) -> None:
        """Check that there is a table of `size` normals, or room for it.

        Raises:
            ConfigError: It fits neither the memory nor the disk.
        """
        path = _path(size)
        if not path.exists():
            cls._check_room(path, size)

    @staticmethod
    def _check_room(path: Path, size: int) -> None:
        """Raise ConfigError unless the table fits the memory, in which it is mapped, and the disk."""
        for free, where in ((free_memory(), "of memory"), (free_disk(path), f"on the disk of {path.parent}")):
            if 4 * size > free:
                most = free // 4
                most -= most % 10 ** max(0, len(str(most)) - 2)
                fix = f"Set --noise-table-size {most} at most, or point" if most > 1 else "Point"
                raise ConfigError(
                    f"noise_table_size is {size:,}, which takes {_in_words(4 * size)}, but {_in_words(free)} {where} "
                    f"are free. {fix} SHES_CACHE_DIR at a larger disk."
                )

    @staticmethod
    def _build(path: Path, size: int, seed: int) -> None:
        """Generate the table and move it into place, so that no process ever sees an unfinished file."""
        sums: list[int] = []

        def write(file: IO[bytes]) -> None:
            for number in range(-(-size // _BLOCK)):
                block = _block(seed, number, min(_BLOCK, size - number * _BLOCK)).tobytes()
                sums.append(zlib.crc32(block))
                file.write(block)

        try:
            with storage_errors(path):
                path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, write)
            write_atomically(_checksums(path), lambda file: file.write(np.array(sums, "<u4").tobytes()))
        except StorageError as error:
            raise StorageError(
                f"the noise table ({4 * size / 1e6:,.0f} MB) cannot be kept: {error} "
                "Point SHES_CACHE_DIR at a folder with room, or lower --noise-table-size."
            ) from error


_COPIES: WeakValueDictionary[tuple[str, Path | int], NoiseTable] = WeakValueDictionary()
"""Tables on devices, by module and file. A table may have a gigabyte, so rollout and update share the copy."""
