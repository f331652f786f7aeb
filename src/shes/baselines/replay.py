"""Replay buffers: the last transitions of a level, in memory.

A `Replay` never changes: `append` returns another one. The two share their memory, a ring with room for one generation
beyond the capacity, so that a checkpoint can be written while the next generation is already stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from shes.types import F32Array

Rows = Mapping[str, F32Array]
"""Transitions: arrays [M, ...] by name."""


class _Ring:
    """Memory for transitions, written in a circle: the transition with number n is in row `n % length`."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], length: int, written: int) -> None:
        self.length, self.written = length, written
        self.arrays = {name: np.empty((length, *shape), np.float32) for name, shape in shapes.items()}

    def write(self, rows: Rows) -> None:
        places = (self.written + np.arange(len(rows["reward"]))) % self.length
        for name, values in rows.items():
            self.arrays[name][places] = values
        self.written += len(places)


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """The last M transitions of a level, at most `capacity`."""

    shapes: Mapping[str, tuple[int, ...]]
    """Shape of each array of a transition, by name; one is `reward`."""
    capacity: int
    slack: int
    """Number of transitions that can be appended before this buffer itself is overwritten."""
    size: int = 0
    """Number of transitions, M."""
    end: int = 0
    """Number of transitions ever appended."""
    _ring: _Ring | None = field(default=None, repr=False)

    @property
    def num_bytes(self) -> int:
        """Bytes of memory that the buffer takes once it is full."""
        return (self.capacity + self.slack) * 4 * sum(int(np.prod(shape)) for shape in self.shapes.values())

    def append(self, rows: Rows) -> Replay:
        """Return the buffer with `rows` as its last transitions, without the oldest if it was full."""
        ring = self._ring
        if ring is None or ring.written != self.end:  # another buffer has gone on from this one
            ring = _Ring(self.shapes, self.capacity + self.slack, self.end - self.size)
            for part in self.parts():
                ring.write(part)
        ring.write(rows)
        size = min(self.size + ring.written - self.end, self.capacity)
        return replace(self, size=size, end=ring.written, _ring=ring)

    def sample(self, rng: np.random.Generator, *shape: int) -> dict[str, F32Array]:
        """Return transitions drawn with replacement, as arrays [*shape, ...]."""
        ring = self._intact()
        places = (self.end - self.size + rng.integers(0, self.size, shape)) % ring.length
        return {name: array[places] for name, array in ring.arrays.items()}

    def parts(self) -> tuple[Rows, Rows]:
        """Return all transitions as two blocks of views, the oldest first: to the end of the ring, and from its start.

        The division depends on the number of transitions alone, so that it is the same after a resume.
        """
        if not self.size:
            nothing = {name: np.empty((0, *shape), np.float32) for name, shape in self.shapes.items()}
            return nothing, nothing
        ring = self._intact()
        first = (self.end - self.size) % ring.length
        count = min(self.size, ring.length - first)
        blocks = slice(first, first + count), slice(self.size - count)
        older, newer = ({name: array[block] for name, array in ring.arrays.items()} for block in blocks)
        return older, newer

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the buffer as arrays by name. They are views: nothing is copied."""
        blocks = zip(("older", "newer"), self.parts(), strict=True)
        rows = {f"{part}/{name}": array for part, block in blocks for name, array in block.items()}
        return {"end": np.array(self.end), **rows}

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> Replay:
        """Return the buffer that `to_arrays` converted; raise KeyError or ValueError unless the arrays fit this one."""
        blocks = [{name: arrays[f"{part}/{name}"] for name in self.shapes} for part in ("older", "newer")]
        sizes = [len(block["reward"]) for block in blocks]
        for block, size in zip(blocks, sizes, strict=True):
            for name, shape in self.shapes.items():
                check_array(f"{name} of a replay buffer", block[name], np.float32, (size, *shape))
        end, size = int(arrays["end"]), sum(sizes)
        if not size <= min(end, self.capacity):
            raise ValueError(f"a replay buffer of {self.capacity} transitions has {size}, of {end} ever made")
        restored = replace(self, size=0, end=end - size, _ring=None)
        for block in blocks:
            restored = restored.append(block)
        return restored

    def emptied(self) -> Replay:
        """Return the buffer without its transitions."""
        return replace(self, size=0, _ring=None)

    def _intact(self) -> _Ring:
        ring = self._ring
        assert ring is not None, "an empty buffer has no transitions"
        assert ring.written - (self.end - self.size) <= ring.length, "the buffer has been overwritten"
        return ring


def check_array(name: str, array: np.ndarray, dtype: np.typing.DTypeLike, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless `array`, of a checkpoint, has this type and shape and only finite values."""
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not {np.dtype(dtype)} of shape {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinity")
