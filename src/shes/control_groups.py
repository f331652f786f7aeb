"""Limits of the control groups (a container, a cluster's job) that contain this process, of versions 1 and 2.

https://docs.kernel.org/admin-guide/cgroup-v2.html and https://docs.kernel.org/admin-guide/cgroup-v1
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

__all__ = ["cpu_quotas", "memory_limits"]

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
