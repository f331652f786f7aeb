"""The gradient estimate: a signed, weighted sum of noise vectors.

Source: SHES paper, Algorithm 1 lines 4 and 5, and II-F (the members of a group share one noise vector, so the sum runs
over groups and is as many times shorter as a group has members).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from shes.arrays import to_host
from shes.es.noise import NoiseTable
from shes.types import F32Array, F64Array, IntArray

__all__ = ["group_weights", "weighted_noise_sum"]

_COLUMNS = 65536  # parameters summed at a time: long enough that Python's lock is no bottleneck of two threads


def group_weights(shaped: F64Array, signs: NDArray[np.int8]) -> F32Array:
    """Return one weight [G] per noise vector: the signed sum of the members' shaped fitness.

    Args:
        shaped: Shaped fitness [n] of the population, group after group.
        signs: Signs [G, M] that the members of each group give to this level's noise vector.
    """
    values = shaped.reshape(signs.shape)
    # In order of size, so that equal values on both sides cancel exactly: what rounding left of nothing would be taken
    # for a direction by an optimizer that does not heed the gradient's length.
    plus, minus = (np.sort(np.where(side, values, 0.0), axis=1).sum(axis=1) for side in (signs > 0, signs < 0))
    return (plus - minus).astype(np.float32)  # no BLAS: the same bits anywhere


def weighted_noise_sum(
    table: NoiseTable, noise_index: IntArray, weights: F32Array, dim: int, pool: ThreadPoolExecutor | None = None
) -> F32Array:
    """Return `sum_g weights[g] * noise(noise_index[g])` [dim].

    Columns are cut into fixed blocks, and each block is summed group by group with elementwise operations: the result
    has the same bits for any number of threads, and on any processor or card, because no BLAS is involved.

    Args:
        table: The shared noise, here or on a device, where the sum is then made.
        noise_index: Start of each group's slice [G].
        weights: Weight of each group [G]; a group of weight zero is not read.
        dim: Parameters of the level.
        pool: Threads that share the blocks; none runs them here.
    """
    total = table.xp.zeros(dim, dtype=np.float32)
    groups = [(int(noise_index[g]), np.float32(weights[g])) for g in np.flatnonzero(weights)]

    def sum_block(start: int) -> None:
        _sum_columns(table.values, groups, start, total[start : start + _COLUMNS])

    if table.xp is not np:  # one block: a card has threads of its own, and the pool's would use another stream
        _sum_columns(table.values, groups, 0, total)
        return to_host(total)
    starts: Sequence[int] = range(0, dim, _COLUMNS)
    if pool is None:
        for start in starts:
            sum_block(start)
    else:
        list(pool.map(sum_block, starts))
    return total


def _sum_columns(values: F32Array, groups: list[tuple[int, np.float32]], start: int, out: F32Array) -> None:
    """Add every group's weighted noise of the columns from `start` into `out` [columns]."""
    product = np.empty_like(out)
    length = len(out)
    for index, weight in groups:
        begin = index + start
        np.multiply(values[begin : begin + length], weight, out=product)
        np.add(out, product, out=out)
