"""Cores, memory and disk that this process may use, within the limits of containers, and signals that must wait."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil
from pathlib import Path
from typing import Any

_OWN_GROUPS = Path("/proc/self/cgroup")
_ROOT = Path("/sys/fs/cgroup")
_MEMINFO, _STATM = Path("/proc/meminfo"), Path("/proc/self/statm")


def _limits(controller: str, *names: str, newest: str) -> Iterator[list[int]]:
    """Yield the numbers in the files of each control group that limits `controller`: `names`, or `newest` alone."""
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
                with suppress(OSError, ValueError):  # no such file, or "max"
                    if each.is_relative_to(root):
                        files = names if controllers else (newest,)
                        yield [int(word) for name in files for word in (each / name).read_text().split()]


def num_cores() -> int:
    """Return how many cores this process may use.

    They are those of its CPU affinity where the system has one, else all; fewer if a control group (a container, a
    cluster's job) has a quota of CPU time, rounded up.
    """
    quotas = _limits("cpu", "cpu.cfs_quota_us", "cpu.cfs_period_us", newest="cpu.max")
    return max(1, min([len(core_numbers()), *(ceil(quota / period) for quota, period in quotas if quota > 0)]))


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


def free_memory() -> int:
    """Return the bytes of memory that this process may still use, without swap.

    It is the least of three: the memory available on the machine, the limit of the control group (a container, a
    cluster's job) and that of the address space (`ulimit -v`).
    """
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, StopIteration):  # Linux alone has these files
        line = next(line for line in _MEMINFO.read_text().splitlines() if line.startswith("MemAvailable:"))
        free = 1024 * int(line.split()[1])
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    own = [] if limit == resource.RLIM_INFINITY else [limit]
    return min([free, *own, *(size for (size,) in _limits("memory", "memory.limit_in_bytes", newest="memory.max"))])


def resident_memory() -> int:
    """Return the bytes of memory that this process has at present; 0 where the system does not tell."""
    with suppress(OSError):
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def free_disk(path: Path) -> int:
    """Return the free bytes on the disk of `path`, which may still be missing; 2**63 if it has none."""
    place = path.absolute()
    usage = shutil.disk_usage(next(each for each in (place, *place.parents) if each.exists()))
    return usage.free if usage.total else 2**63  # /proc has no size: writing there shows what is wrong


@contextmanager
def signals_delayed() -> Iterator[None]:
    """Handle a signal after the block, which makes an environment: one half made cannot be closed. Not a second one."""
    is_inside, late, owner = threading.current_thread() is threading.main_thread(), list[int](), os.getpid()
    numbers = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM) if is_inside else ()
    handlers: dict[int, Any] = {each: now for each in numbers if callable(now := signal.getsignal(each))}

    def keep(number: int, frame: Any) -> None:
        now = [*late, number]
        late[:] = now if is_inside and not late and os.getpid() == owner else []  # a forked process inherits `keep`
        for each in () if late else now:
            handlers[each](each, frame)

    try:
        for number in handlers:
            signal.signal(number, keep)
        yield
    finally:
        is_inside = False
        for number in (each for each in handlers if signal.getsignal(each) is keep):
            signal.signal(number, handlers[number])
        for number in late:
            signal.raise_signal(number)
