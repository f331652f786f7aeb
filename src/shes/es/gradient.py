"""The gradient estimate: a signed, weighted sum of noise vectors.

Source: SHES paper, Algorithm 1 lines 4 and 5, and section II-F. The members of a group share one noise vector, so the
sum runs over groups instead of members.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from shes.es.noise import NoiseTable
from shes.host_arrays import to_host
from shes.types import F32Array, F64Array, IntArray

_COLUMNS = 65536  # parameters summed at a time: enough that two threads do not wait for Python's lock


def group_weights(shaped: F64Array, signs: NDArray[np.int8]) -> F32Array:
    """Return one weight [G] per noise vector: the signed sum of the members' shaped fitness.

    Args:
        shaped: Shaped fitness [n] of the population, group after group.
        signs: Signs [G, M] of each group's members at one level.
    """
    values = shaped.reshape(signs.shape)
    # Sorted, so that equal values on both sides cancel exactly. Optimizers that ignore the gradient's length would take
    # a rounding error for a direction.
    plus, minus = (np.sort(np.where(side, values, 0.0), axis=1).sum(axis=1) for side in (signs > 0, signs < 0))
    return (plus - minus).astype(np.float32)


def weighted_noise_sum(
    table: NoiseTable, noise_index: IntArray, weights: F32Array, dim: int, pool: ThreadPoolExecutor | None = None
) -> F32Array:
    """Return `sum_g weights[g] * noise(noise_index[g])` [dim].

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
