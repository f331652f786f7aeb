"""Wall-clock time to a Gather score, ours beside HIRO: `python benchmarks/time_to_score.py --out results/hiro`.

Reads two tables in the folder: `gather_hiro_curves.csv` (made at commit 5de091c by `python benchmarks/seeds.py gather
--spec hiro --integrator euler --results results/hiro`; the time of a walker counts) and `curves.csv` (`python
benchmarks/hiro_runs.py --results results/hiro`).
Writes `time_to_score.csv`, a row for each run and score: seconds and environment steps at the first evaluation with a
mean of at least that score, both empty if there was none, and the seconds and best score of the whole run. Draws the
curves as `time_to_score.png`.
"""

from __future__ import annotations

import argparse
import csv
import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any

from run import write_csv

SCORES = (1.0, 2.0, 3.0)
LABELS = {
    "coevolved": "SHES, both levels from scratch",
    "transfer": "SHES, on a walker (its time counts)",
    "hiro-ant-gather": "HIRO",
}
Curve = list[tuple[float, int, float]]
"""Seconds, environment steps and score of every evaluation."""


def curves(folder: Path) -> dict[tuple[str, int], Curve]:
    """Return the curve of each run by method and seed, in the order of `LABELS`."""
    found: dict[tuple[str, int], Curve] = defaultdict(list)
    for file, column in (("gather_hiro_curves.csv", "way"), ("curves.csv", "group")):
        with (folder / file).open(newline="", encoding="utf-8") as lines:
            for row in csv.DictReader(lines):
                method = row[column]
                if method in LABELS:
                    point = float(row["wall_time_s"]), int(float(row["env_steps"])), float(row["score_mean"])
                    found[method, int(row["seed"])].append(point)
    order = list(LABELS)
    return {key: sorted(found[key]) for key in sorted(found, key=lambda key: (order.index(key[0]), key[1]))}


def first(curve: Curve, score: float) -> tuple[float, int] | tuple[None, None]:
    """Return seconds and environment steps of the first evaluation with at least `score`; None without one."""
    return next(((seconds, steps) for seconds, steps, found in curve if found >= score), (None, None))


def rows(found: dict[tuple[str, int], Curve]) -> list[dict[str, Any]]:
    """Return the rows of the table."""
    return [
        {
            "method": method,
            "seed": seed,
            "score": score,
            **dict(zip(("seconds", "env_steps"), first(curve, score), strict=True)),
            "seconds_in_all": round(curve[-1][0]),
            "best_score": max(each[2] for each in curve),
        }
        for (method, seed), curve in found.items()
        for score in SCORES
    ]


def draw(found: dict[tuple[str, int], Curve], path: Path) -> None:
    """Draw the score of every run over the minutes since its start."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(8, 4.5))
    colours = dict(zip(LABELS, ("C0", "C2", "C3"), strict=True))
    for (method, seed), curve in found.items():
        is_first = seed == min(other for name, other in found if name == method)
        x, y = [seconds / 60 for seconds, _, _ in curve], [score for _, _, score in curve]
        axis.plot(x, y, color=colours[method], alpha=0.8, label=LABELS[method] if is_first else None)
    for score in SCORES:
        axis.axhline(score, color="grey", linewidth=0.6, linestyle="dotted")
    axis.set(xscale="log", xlabel="minutes of wall-clock", ylabel="score of Ant Gather (spec hiro)")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.grid(alpha=0.3)
    axis.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main() -> None:
    """Write the table, draw the curves, and print medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/hiro"), help="folder of the tables and the figure")
    out = parser.parse_args().out
    found = curves(out)
    table = rows(found)
    write_csv(out / "time_to_score.csv", table)
    draw(found, out / "time_to_score.png")
    for method in dict.fromkeys(row["method"] for row in table):
        for score in SCORES:
            own = [row for row in table if row["method"] == method and row["score"] == score]
            times = [row["seconds"] for row in own if row["seconds"] is not None]
            median = f"median {statistics.median(times):.0f} s" if times else f"none in {own[0]['seconds_in_all']} s"
            print(f"{method}, score {score:g}: {len(times)} of {len(own)} runs, {median}")


if __name__ == "__main__":
    main()
