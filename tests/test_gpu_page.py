"""The numbers of docs/how-to/gpu.md are those of `results/gpu`."""

import csv
import math
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "gpu"
PAGE = " ".join((ROOT / "docs" / "how-to" / "gpu.md").read_text(encoding="utf-8").split())
PER_CORE = (14_700, 6_350)  # of docs/experiment_tables.py


def rows_of(name):
    with (RESULTS / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return [{**row} for row in csv.DictReader(file)]


def physics():
    rows = rows_of("worlds")
    return [f"{int(row['worlds']):,} worlds | {round(float(row['env_steps_per_s']), -3):,.0f} |" for row in rows]


def generation():
    launches, whole = rows_of("generations")
    speed, seconds = float(whole["env_steps_per_s"]), float(whole["generation_s"])
    fewest, most = (speed / each for each in PER_CORE)
    return [
        f"({float(whole['env_steps']) / 1e6:.1f} million steps in {seconds:.1f} s) | {round(speed, -3):,.0f} |",
        f"as {fewest:.0f} to {most:.0f} of the cores",
        f"would take {3000 * seconds / 3600:.1f} hours",
        f"A generation of four policies takes {float(launches['generation_s']):.1f} s",
    ]


def time_text(row):
    minutes, seconds = divmod(round(float(row["wall_time_s"])), 60)
    return f"{minutes} min {seconds} s"


def best(run):
    """Return which generation of a run the best checkpoint is, in words."""
    row = max(rows_of(f"{run}/evaluation"), key=lambda row: float(row["score_mean"]))
    last = rows_of(f"{run}/progress")[-1]["generation"]
    millions = float(row["env_steps"]) / 1e6
    return f"(generation {row['generation']} of {last}: {millions:.0f} million steps, {time_text(row)})"


def gatherer():
    first, second = (
        next(float(row["wall_time_s"]) for row in rows_of("ant-gather/evaluation") if float(row["score_mean"]) > least)
        for least in (3.4, 4.9)
    )
    row = rows_of("agents")[0]
    error = float(row["score_std"]) / math.sqrt(int(row["episodes"]) - 1)
    return [
        f"{best('ant-gather')} scores {float(row['score_mean']):.2f} ± {error:.2f} over 400 other episodes",
        f"passes 3.4 after {first:.0f} s and 4.9 after {second:.0f} s",
    ]


def pusher():
    found = next(row for row in rows_of("ant-push/evaluation") if float(row["score_mean"]) > 0)
    share = f"{100 * float(found['score_mean']):.1f} %"
    return [
        f"{best('ant-push')} reaches the target in {100 * float(rows_of('agents')[1]['score_mean']):.0f} % of 400",
        f"the {found['generation']}th generation, after {time_text(found)}, with {share}",
    ]


def speeds():
    last = [rows_of(f"{run}/progress")[-1] for run in ("ant-gather", "ant-push")]
    fast, slow = (round(float(row["env_steps"]) / float(row["wall_time_s"]), -3) for row in last)
    return [f"made {fast:,.0f} and {slow:,.0f} steps per second"]


@pytest.mark.parametrize("claim", [physics, generation, gatherer, pusher, speeds])
def test_the_page_says_what_the_tables_say(claim):
    for words in claim():
        assert words in PAGE
