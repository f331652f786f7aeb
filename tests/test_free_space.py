"""Free memory under `ulimit`, and free disk. For control groups see `test_control_groups.py`."""

import shutil
import subprocess
import sys

import pytest

from shes.machine import free_disk


def test_a_limit_of_the_address_space_counts():
    code = "from shes.machine import free_memory; print(free_memory())"
    command = ["bash", "-c", f"ulimit -v 4000000; exec {sys.executable} -c '{code}'"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 4_000_000 * 1024


def test_the_disk_of_a_missing_path_is_that_of_its_nearest_folder(tmp_path):
    assert free_disk(tmp_path / "a" / "b" / "c") == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)
