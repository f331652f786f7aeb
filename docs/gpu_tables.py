"""The tables of `how-to/gpu.md`, made from `results/gpu`. `python docs/gpu_tables.py` writes them into the page."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

from markdown_table import table

PAGE = Path(__file__).parent / "how-to" / "gpu.md"
RESULTS = Path(__file__).parents[1] / "results" / "gpu"
BEGIN, END = "<!-- measured -->", "<!-- end -->"


def filled(page: str) -> str:
    """Return `page` with its tables made anew."""
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    return f"{before}{BEGIN}\n\n{speeds()}\n\n{run()}\n\n{END}{after}"


def speeds() -> str:
    """Return the table of environment steps per second."""
    rows = [
        (row["card"], f"physics alone, {int(row['worlds']):,} worlds", _thousands(float(row["env_steps_per_s"])))
        for row in _rows("worlds")
    ]
    for row in _rows("generations"):
        policies, seconds = int(row["policies"]), float(row["generation_s"])
        option = " with `--deterministic`" if row["deterministic"] == "True" else ""
        words = f"a generation of {policies} × {row['episodes']} episodes{option}: {seconds:.1f} s"
        rows.append((row["card"], words, _thousands(float(row["env_steps_per_s"]))))
    return table(("card", "Ant Gather", "environment steps per second"), rows, ("environment steps per second",))


def run() -> str:
    """Return the table of the run: its best generation, and the scores of its controllers."""
    agents = _rows("agents")
    best = max(_rows("ant-gather/evaluation"), key=lambda row: float(row["score_mean"]))
    last = _rows("ant-gather/progress")[-1]
    found = f"{best['generation']} of {last['generation']}", f"{float(best['env_steps']) / 1e6:.0f}", _time(best)
    speed = _thousands(float(last["env_steps"]) / float(last["wall_time_s"]))
    scores = (f"{float(each['score_mean']):.2f} ± {_error(each):.2f}" for each in agents)
    header = ("best generation", "million steps", "time", "steps/s", *(each["controller"] for each in agents))
    return table(header, [(*found, speed, *scores)])


def _error(agent: Mapping[str, str]) -> float:
    return float(agent["score_std"]) / math.sqrt(int(agent["episodes"]) - 1)


def _rows(name: str) -> list[Mapping[str, str]]:
    with (RESULTS / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _thousands(value: float) -> str:
    return f"{round(value, -3):,.0f}"


def _time(row: Mapping[str, str]) -> str:
    minutes, seconds = divmod(round(float(row["wall_time_s"])), 60)
    return f"{minutes} min {seconds} s"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
