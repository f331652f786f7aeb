"""Free memory and disk space, for the check that the arrays and files of a run fit before they are made."""

from __future__ import annotations

import os
import resource
import shutil
from contextlib import suppress
from pathlib import Path

from shes.control_groups import memory_limits

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
