"""Wall-clock of a run that evaluates and keeps a checkpoint in every generation.

Compares evaluation beside the next generation with evaluation at once, in interleaved runs of the same numbers; with
`--against FOLDER`, also with another version of the package in that folder. Prints medians, and ratios to the first.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

SETTINGS = "--evaluation-interval 1 --keep-checkpoints 1 --evaluation-episodes 10"
ENV = "ant-gather --horizon 100 --population-size 80 --primitive-population-size 400"
RUN = """
import sys, time
from shes.backends.backend import Backend
from shes.backends.pull import PullBackend
from shes.cli.program import main
if sys.argv.pop(1) == "at once":
    PullBackend.beside = Backend.beside
start = time.perf_counter()
code = main(sys.argv[1:])
print(time.perf_counter() - start, file=sys.stderr)
sys.exit(code)
"""


def seconds(source: str, how: str, words: list[str]) -> float:
    """Return the seconds of a training run with the package in folder `source`."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", RUN, how, "train", *words, "--out", f"{folder}/run"]
        environment = {**os.environ, "PYTHONPATH": source}
        done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return float(done.stderr.split()[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each kind")
    parser.add_argument("--generations", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--settings", default=ENV, help="environment and settings of shes train")
    parser.add_argument("--against", help="folder with another version of the package")
    asked = parser.parse_args()
    words = f"{asked.settings} {SETTINGS} --workers {asked.workers} --generations {asked.generations}".split()
    here = str(Path(__file__).parents[1] / "src")
    kinds = {"beside": (here, "beside"), "at once": (here, "at once")}
    if asked.against:
        kinds[asked.against] = (asked.against, "beside")
    found: dict[str, list[float]] = {kind: [] for kind in kinds}
    for _ in range(asked.rounds):
        for kind, (source, how) in kinds.items():
            found[kind].append(seconds(source, how, words))
            print(f"{kind}: {found[kind][-1]:.1f} s", flush=True)
    first = found["beside"]
    for kind, times in found.items():
        ratio = statistics.median(each / own for each, own in zip(times, first, strict=True))
        print(f"{kind}: median {statistics.median(times):.1f} s, {ratio:.3f} of beside")


if __name__ == "__main__":
    main()
