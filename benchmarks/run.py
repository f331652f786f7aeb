"""Speed of rollouts: `make bench`, on an idle machine. Each row is `shes bench rollout` in a process of its own.

Prints the table of `results/README.md` and, with `--out FILE`, writes every number as CSV.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import sleep

import psutil

MLP = "--controller-network mlp --hidden 64 64 --primitive-hidden 64 64 --population-size 240"
PAPER = "--preset paper --population-size 40 --noise-table-size 25000000"
SECONDS = "--seconds 60"
TASKS = ("gather", "flagrun", "maze", "push", "fall")
ROLLOUTS = [
    *((f"Ant {task.title()}, 1 worker", 0.90, f"ant-{task} --workers 1") for task in TASKS),
    ("Ant Gather, 64 x 64, 1 worker", 0.90, f"ant-gather --workers 1 {MLP}"),
    ("Ant Gather, 64 x 64, 2 workers", None, f"ant-gather --workers 2 {MLP}"),
    ("Ant Gather, 3 x 256, 1 worker", 0.75, f"ant-gather --workers 1 {PAPER}"),
    ("Point Gather, 64 x 64, 1 worker", None, f"point-gather --workers 1 {MLP}"),
]
"""Name, required ratio and arguments of `shes bench rollout`."""


def bench(arguments: str) -> dict[str, float]:
    """Return what `shes bench rollout ARGUMENTS` measures."""
    command = [sys.executable, "-m", "shes", "bench", "rollout", *arguments.split(), "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def worker_memory_mb() -> float:
    """Return the peak resident memory of a worker of the paper's size beyond the noise table, in MB."""
    with tempfile.TemporaryDirectory() as folder:
        settings = f"{PAPER} --generations 2 --workers 1 --horizon 100"
        command = [sys.executable, "-m", "shes", "train", "ant-gather", *settings.split(), "--out", f"{folder}/run"]
        run = psutil.Popen(command, stdout=subprocess.DEVNULL)
        peak = 0.0
        while run.poll() is None:
            sleep(0.1)
            try:
                for worker in run.children():
                    maps = worker.memory_maps(grouped=True)
                    peak = max(peak, sum(m.rss for m in maps if "noise-v" not in m.path) / 1e6)
            except psutil.Error:
                continue  # the worker has just ended
        if run.returncode:
            raise SystemExit("the training run failed")
        return peak


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows under the columns of the first one; a missing value is empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    out = parser.parse_args().out
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    print(f"| {'rollout':34} | env steps/s | bare mj_step/s | ratio | required |")
    print(f"|{'-' * 36}|------------:|---------------:|------:|---------:|")
    found: dict[str, float] = {}
    for name, required, arguments in ROLLOUTS:
        measured = bench(f"{arguments} {SECONDS}")
        speed, bare, ratio = (measured[key] for key in ("env_steps_per_s", "bare_steps_per_s", "ratio"))
        found |= {f"{name}: env_steps_per_s": speed, f"{name}: bare_steps_per_s": bare, f"{name}: ratio": ratio}
        print(f"| {name:34} | {speed:11,.0f} | {bare:14,.0f} | {ratio:5.2f} | {required or '':>8} |", flush=True)
    one, two = (found[f"Ant Gather, 64 x 64, {n}: env_steps_per_s"] for n in ("1 worker", "2 workers"))
    print(f"\nSpeed-up of two workers: {two / one:.2f}.")
    memory = worker_memory_mb()
    print(f"\nA worker of the paper's size holds at most {memory:,.0f} MB beyond the noise table.")
    if out is not None:
        found |= {"worker at paper size: MB beyond the noise table": memory, "two workers against one": two / one}
        write_csv(out, [{"measure": measure, "value": value} for measure, value in found.items()])


if __name__ == "__main__":
    main()
