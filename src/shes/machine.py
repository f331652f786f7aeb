"""Cores, memory and disk that this process may use, within the limits of containers."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil
from pathlib import Path

_OWN_GROUPS = Path("/proc/self/cgroup")
_ROOT = Path("/sys/fs/cgroup")


def memory_limits() -> list[int]:
    """Return the memory limit in bytes of each control group that has one."""
    limits: list[int] = []
    for version, folder in _groups("memory"):
        with suppress(OSError, ValueError):  # no such file, or "max"
            limits.append(int((folder / ("memory.limit_in_bytes" if version == 1 else "memory.max")).read_text()))
    return limits


def cpu_quotas() -> list[float]:
    """Return the number of CPUs that each control group with a quota may use on average."""
    quotas: list[float] = []
    for version, folder in _groups("cpu"):
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if version == 1 else ("cpu.max",)
        with suppress(OSError, ValueError):  # no such file, or "max"
            quota, period = map(int, " ".join((folder / name).read_text() for name in names).split())
            if quota > 0:  # -1 is none
                quotas.append(quota / period)
    return quotas


def _groups(controller: str) -> Iterator[tuple[int, Path]]:
    """Yield the version and the folder of this process's control groups that may limit `controller`."""
    lines: list[str] = []
    with suppress(OSError):  # Linux alone has it
        lines = _OWN_GROUPS.read_text().splitlines()
    for line in lines:
        _, controllers, own = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        for root in (_ROOT / controllers, _ROOT / controller) if controllers else (_ROOT, _ROOT / "unified"):
            folder = root / own.strip("/")
            for each in (folder, *folder.parents):  # a container may see its own group as the root
                if each.is_relative_to(root):
                    yield (1 if controllers else 2), each


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


__all__ = ["free_disk", "free_memory", "resident_memory"]

_MEMINFO, _STATM = Path("/proc/meminfo"), Path("/proc/self/statm")


def free_memory() -> int:
    """Return the bytes of memory that this process may still use, without swap.

    It is the least of the memory available on the machine, the limit of the control group (a container, a cluster's
    job) and the limit of the address space (`ulimit -v`).
    """
    available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, StopIteration):  # Linux alone has these files
        line = next(line for line in _MEMINFO.read_text().splitlines() if line.startswith("MemAvailable:"))
        available = 1024 * int(line.split()[1])
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return min([available, *memory_limits(), *([] if limit == resource.RLIM_INFINITY else [limit])])


def resident_memory() -> int:
    """Return the bytes of memory that this process has at present; 0 where the system does not tell."""
    with suppress(OSError):
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def free_disk(path: Path) -> int:
    """Return the free bytes on the disk of `path`, which may still be missing."""
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    return shutil.disk_usage(place).free
