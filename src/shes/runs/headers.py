"""The headers of the arrays in an `.npz` file: shapes and types, read without the arrays."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass

import numpy as np

SUFFIX = ".npy"
"""End of the name of every member of the file."""


@dataclass(frozen=True)
class Header:
    """Shape and type of an array in a file."""

    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def nbytes(self) -> int:
        """Bytes of the array in memory."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_headers(archive: zipfile.ZipFile) -> dict[str, Header]:
    """Return the header of every array by name; raise ValueError if one is damaged or holds objects."""
    assert archive.fp is not None
    size = archive.fp.seek(0, 2)
    headers = {}
    for info in archive.infolist():
        if not info.filename.endswith(SUFFIX) or not info.filename.isprintable():
            raise ValueError(f"{info.filename!r} is not an array")
        name = info.filename.removesuffix(SUFFIX)
        with archive.open(info) as member:
            version = np.lib.format.read_magic(member)
            if version not in _READERS:
                raise ValueError(f"{name} has version {version} of the array format")
            shape, _, dtype = _READERS[version](member)
            header = Header(shape, dtype)
            if dtype.hasobject or not dtype.itemsize or min(shape, default=0) < 0:
                raise ValueError(f"{name} has type {dtype} and shape {shape}")
            if info.file_size != member.tell() + header.nbytes or info.compress_size > size:
                raise ValueError(f"{name} of shape {shape} does not have {header.nbytes} bytes")
        headers[name] = header
    return headers


_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
"""Readers of a header by version of the array format."""
