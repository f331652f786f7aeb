"""Limits of control groups, of both versions, and of `ulimit`: free memory and the number of cores follow them."""

import os
import resource
import shutil
import subprocess
import sys

import pytest

from shes import machine as this_machine
from shes.machine import core_numbers, free_disk, free_memory, num_cores

GIB = 2**30


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with 8 GiB of available memory and 8 cores, and files to change it."""
    (tmp_path / "meminfo").write_text("MemTotal: 16777216 kB\nMemAvailable:    8388608 kB\n")
    (tmp_path / "own").write_text("5:cpu,cpuacct:/job\n4:memory:/job\n1:name=x:/other\n0::/jobs/7\n")
    monkeypatch.setattr(this_machine, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(this_machine, "_OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr(this_machine, "_ROOT", tmp_path / "groups")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    monkeypatch.setattr("shes.machine.core_numbers", lambda: list(range(8)))
    return tmp_path


@pytest.mark.parametrize(
    ("find", "files", "expected"),
    [
        (free_memory, {}, 8 * GIB),
        (free_memory, {"jobs/memory.max": "1073741824", "jobs/7/memory.max": "max"}, GIB),
        (free_memory, {"jobs/memory.max": "2147483648", "jobs/7/memory.max": "1073741824"}, GIB),
        (free_memory, {"memory.max": "1073741824"}, GIB),
        (free_memory, {"unified/jobs/7/memory.max": "1073741824"}, GIB),
        (free_memory, {"memory/job/memory.limit_in_bytes": "1073741824"}, GIB),
        (free_memory, {"memory/memory.limit_in_bytes": "1073741824"}, GIB),  # in a container: its group is its root
        (free_memory, {"memory/job/memory.limit_in_bytes": "9223372036854771712"}, 8 * GIB),  # "none" in version 1
        (free_memory, {"memory/other/memory.limit_in_bytes": "1073741824"}, 8 * GIB),
        (num_cores, {}, 8),
        (num_cores, {"jobs/7/cpu.max": "max 100000"}, 8),
        (num_cores, {"jobs/7/cpu.max": "250000 100000"}, 3),
        (num_cores, {"jobs/7/cpu.max": "20000 100000"}, 1),
        (num_cores, {"jobs/cpu.max": "300000 100000", "jobs/7/cpu.max": "400000 100000"}, 3),
        (num_cores, {"jobs/7/cpu.max": "1600000 100000"}, 8),
        (num_cores, {"cpu/job/cpu.cfs_quota_us": "50000", "cpu/job/cpu.cfs_period_us": "25000"}, 2),
        (num_cores, {"cpu,cpuacct/job/cpu.cfs_quota_us": "9", "cpu,cpuacct/job/cpu.cfs_period_us": "3"}, 3),
        (num_cores, {"cpu/job/cpu.cfs_quota_us": "-1", "cpu/job/cpu.cfs_period_us": "100000"}, 8),
    ],
)
def test_memory_and_cores_are_at_most_the_least_limit(machine, find, files, expected):
    for name, text in files.items():
        path = machine / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    assert find() == expected


def test_a_system_without_these_files_has_what_it_has(machine):
    (machine / "meminfo").unlink()
    (machine / "own").unlink()
    assert free_memory() == os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert num_cores() == 8
    assert len(core_numbers()) >= 1


def test_a_limit_of_the_address_space_counts():
    code = "from shes.machine import free_memory; print(free_memory())"
    command = ["bash", "-c", f"ulimit -v 4000000; exec {sys.executable} -c '{code}'"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 4_000_000 * 1024


def test_a_missing_path_has_the_disk_of_its_nearest_folder(tmp_path):
    assert free_disk(type(tmp_path)("/proc/none")) == 2**63  # no disk, rather than a full one
    assert free_disk(tmp_path / "a" / "b" / "c") == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)
