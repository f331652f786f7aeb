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
        f"a generation of four policies takes {float(launches['generation_s']):.1f} s",
    ]


def score(row):
    error = float(row["score_std"]) / math.sqrt(int(row["episodes"]) - 1)
    return f"{float(row['score_mean']):.2f} ± {error:.2f} over {row['episodes']} other episodes"


def gatherer():
    first, second = (
        next(float(row["wall_time_s"]) for row in rows_of("ant-gather/evaluation") if float(row["score_mean"]) > least)
        for least in (3.4, 4.9)
    )
    last = rows_of("ant-gather/progress")[-1]
    return [
        f"scores {score(rows_of('agents')[0])}",
        f"after {last['generation']} generations, {float(last['env_steps']) / 1e6:.0f} million steps",
        f"passes 3.4 after {first:.0f} s and 4.9 after {second:.0f} s",
    ]


def pusher():
    last = rows_of("ant-push/progress")[-1]
    found = next(row for row in rows_of("ant-push/evaluation") if float(row["score_mean"]) > 0)
    minutes, seconds = divmod(round(float(found["wall_time_s"])), 60)
    share = f"{100 * float(found['score_mean']):.1f} %"
    return [
        f"in {100 * float(rows_of('agents')[1]['score_mean']):.0f} % of 400 other episodes",
        f"after {last['generation']} generations, {float(last['env_steps']) / 1e6:.0f} million steps",
        f"the {found['generation']}th generation, after {minutes} min {seconds} s, with {share}",
    ]


@pytest.mark.parametrize("claim", [physics, generation, gatherer, pusher])
def test_the_page_says_what_the_tables_say(claim):
    for words in claim():
        assert words in PAGE
