"""`shes compare` and `shes experiment`: differences between runs, and studies of many runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from shes.cli.output import print_line, show
from shes.cli.parsing import Json
from shes.runs.rooms import WorkerSettings
from shes.studies.index import STUDIES
from shes.studies.perform import perform
from shes.studies.run_comparison import compare_runs


def compare(*, json: Json = False, **options: Annotated[Any, "shes.studies.run_comparison.compare_runs"]) -> int:
    """Compare two runs, or two folders of runs that differ in the seed, on the same fresh episodes.

    The interval of the difference is Welch's; p is that of a permutation test. Needs SciPy (extra study).

    shes compare runs/base runs/sweep/sigma-0.05
    """
    return show(compare_runs(**options).listing(options["first"], options["second"]), json)


def experiment(
    name: Literal["ablation", "learning"],
    *,
    out: Path | None = None,
    workers: int = 0,
    scale: Literal["laptop", "smoke"] = "laptop",
    seeds: int | None = None,
    only: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="GROUP [GROUP ...]")] = None,
    json: Json = False,
) -> int:
    """Run a study of many runs and draw its figures. The same command continues a study that was stopped.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the paper's choices, a sweep of the settings, transfer and horizon, on Point Gather and Maze;
            learning: the worth of each part of the walker's learning, on Ant Flagrun.
        out: Folder of its runs, tables and figures; finished runs in it are kept. runs/ and its name if none.
        workers: Runs at a time; 0 is one for every core.
        scale: laptop: hours on two cores; smoke: a minute, as a test.
        seeds: Seeds of every variant; if none 10, and 5 in a sweep and in learning (smoke: 2).
        only: Groups to run beside the base; all if none. ablation: choices, horizon, sweep, transfer; learning:
            alternatives, form, pieces, sweep.
    """
    out, count = out or Path("runs") / name, WorkerSettings(num_workers=workers).count
    say = (lambda _: None) if json else print_line
    return show(perform(STUDIES[name](scale, seeds), out, only, count, say), json)
