"""The table of ratios in the README: `make bench`, on an idle machine. Each row is `shes bench` in its own process.

Prints the table and, with `--out FILE`, writes every number as CSV.
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
from pathlib import Path
from time import sleep

import psutil

# name, what the ratio must at least be, arguments of `shes bench`
ROLLOUTS = [
    ("Ant Gather, 64 x 64, 1 worker", 0.85, ["ant-gather", "--workers", "1"]),
    ("Ant Gather, 64 x 64, 2 workers", None, ["ant-gather", "--workers", "2"]),
    (
        "Ant Gather, 3 x 256, 1 worker",
        0.75,
        [
            "ant-gather",
            "--preset",
            "paper",
            "--population-size",
            "40",
            "--noise-table-size",
            "25000000",
            "--workers",
            "1",
        ],
    ),
    ("Point Gather, 64 x 64, 1 worker", None, ["point-gather", "--workers", "1"]),
]
LAPTOP = ["--hidden", "64", "64", "--horizon", "500", "--population-size", "240"]
SECONDS = ["--seconds", "60"]


def bench(arguments: list[str]) -> dict[str, float]:
    """Run `shes bench` and return what it measured."""
    command = [sys.executable, "-m", "shes", "bench", *arguments, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def worker_memory_mb() -> float:
    """Return the most that a worker of the paper's size holds beyond the noise table, in MB (resident)."""
    with tempfile.TemporaryDirectory() as folder:
        settings = "--preset paper --population-size 40 --noise-table-size 25000000 --generations 2 --workers 1"
        command = [sys.executable, "-m", "shes", "train", "ant-gather", *settings.split(), "--out", f"{folder}/run"]
        run = psutil.Popen([*command, "--horizon", "100"], stdout=subprocess.DEVNULL)
        most = 0.0
        while run.poll() is None:
            sleep(0.1)
            try:
                for worker in run.children():
                    maps = worker.memory_maps(grouped=True)
                    most = max(most, sum(m.rss for m in maps if "noise-v" not in m.path) / 1e6)
            except psutil.Error:
                continue  # it has just ended
        if run.returncode:
            raise SystemExit("the training run failed")
        return most


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    out = parser.parse_args().out
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    print(f"| {'rollout':34} | env steps/s | bare mj_step/s | ratio | at least |")
    print(f"|{'-' * 36}|------------:|---------------:|------:|---------:|")
    rows: list[dict[str, object]] = []
    for name, least, arguments in ROLLOUTS:
        settings = arguments if "--preset" in arguments else [*arguments, *LAPTOP]
        found = bench(["rollout", *settings, *SECONDS])
        rows.append({"name": name, **{key: found[key] for key in ("env_steps_per_s", "bare_steps_per_s", "ratio")}})
        speed, bare, ratio = found["env_steps_per_s"], found["bare_steps_per_s"], found["ratio"]
        print(f"| {name:34} | {speed:11,.0f} | {bare:14,.0f} | {ratio:5.2f} | {least or '':>8} |", flush=True)
    speedup = float(str(rows[1]["env_steps_per_s"])) / float(str(rows[0]["env_steps_per_s"]))
    print(f"\nTwo workers against one: {speedup:.2f} times.")
    update = bench(["update", "ant-gather", "--preset", "paper"])
    print("\nThe parent's work between generations at paper size, milliseconds (medians):")
    for key, value in update.items():
        print(f"  {key:14} {value:,.1f}")
    memory = worker_memory_mb()
    print(f"\nA worker at paper size holds at most {memory:,.0f} MB beyond the noise table.")
    if out is not None:
        with out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["measure", "value"])
            writer.writerows([f"{row['name']}: {key}", row[key]] for row in rows for key in row if key != "name")
            writer.writerow(["worker at paper size: MB beyond the noise table", memory])
            writer.writerow(["two workers against one", speedup])
            writer.writerows([f"update at paper size: {key}", value] for key, value in update.items())


if __name__ == "__main__":
    main()
