"""`benchmarks/gpu.py`, at its smallest and without a card: every stage runs and writes its table."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "gpu.py"


@pytest.mark.extras
def test_every_stage_writes_its_table(tmp_path):
    options = ["--smoke", "--device", "warp-cpu", "--minutes", "0.1", "--out", str(tmp_path)]
    subprocess.run([sys.executable, str(SCRIPT), *options], check=True, timeout=600)
    for name in ("check", "limits", "generations", "worlds", "point-flagrun/progress", "point-gather/progress"):
        with (tmp_path / f"{name}.csv").open(newline="") as file:
            assert list(csv.DictReader(file)), name
