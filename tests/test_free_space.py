"""Free memory and disk: the least of what the machine, the control group and `ulimit` allow."""

import os
import resource
import shutil
import subprocess
import sys

import pytest

from shes import free_space
from shes.free_space import free_disk, free_memory


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with 8 GiB of available memory, and files to change it."""
    (tmp_path / "meminfo").write_text("MemTotal: 16777216 kB\nMemAvailable:    8388608 kB\n")
    (tmp_path / "own").write_text("1:name=x:/other\n0::/jobs/7\n")
    (tmp_path / "groups" / "jobs" / "7").mkdir(parents=True)
    for name, path in {"_MEMINFO": "meminfo", "_OWN_GROUPS": "own", "_GROUPS": "groups"}.items():
        monkeypatch.setattr(free_space, name, tmp_path / path)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return tmp_path


def test_memory_is_what_the_machine_has_available(machine):
    assert free_memory() == 8 * 2**30


@pytest.mark.parametrize("group", ["jobs/7", "jobs", "."])
def test_a_limit_of_a_control_group_or_of_one_around_it_counts(machine, group):
    (machine / "groups" / group / "memory.max").write_text("1073741824\n")
    assert free_memory() == 2**30


def test_a_control_group_without_a_limit_does_not_count(machine):
    (machine / "groups/jobs/7/memory.max").write_text("max\n")
    assert free_memory() == 8 * 2**30


def test_a_system_without_these_files_has_its_physical_memory(machine):
    (machine / "meminfo").unlink()
    (machine / "own").unlink()
    assert free_memory() == os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def test_a_limit_of_the_address_space_counts():
    code = "from shes.free_space import free_memory; print(free_memory())"
    command = ["bash", "-c", f"ulimit -v 4000000; exec {sys.executable} -c '{code}'"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 4_000_000 * 1024


def test_the_disk_of_a_missing_path_is_that_of_its_nearest_folder(tmp_path):
    assert free_disk(tmp_path / "a" / "b" / "c") == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)
