"""The processor's cores that this process may use."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from math import ceil

from shes.control_groups import cpu_quotas

__all__ = ["core_numbers", "num_cores", "on_one_core"]


def num_cores() -> int:
    """Return how many cores this process may use.

    They are those of its CPU affinity where the system has one, else all; fewer if a control group (a container, a
    cluster's job) has a quota of CPU time, rounded up.
    """
    return max(1, min([len(core_numbers()), *map(ceil, cpu_quotas())]))


def core_numbers() -> list[int]:
    """Return the numbers of the cores that this process may use, in order."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


@contextmanager
def on_one_core(core: int | None = None) -> Iterator[None]:
    """Keep this thread and new child processes on a core inside the block, if the system can; None is the last one."""
    if not hasattr(os, "sched_getaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores) if core is None else core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
