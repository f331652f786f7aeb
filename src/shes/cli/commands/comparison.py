"""`shes compare`: the difference between runs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Literal

import tyro

from shes.cli.output import print_facts, print_line, print_table
from shes.cli.parsing import Checkpoint, Json, Workers
from shes.studies.run_comparison import compare_runs

_Side = Annotated[str, tyro.conf.arg(metavar="RUN", help="A run, a folder of runs, or a shipped agent.")]


def compare(
    first: _Side,
    second: _Side,
    *,
    measure: Literal["score", "return", "success"] = "score",
    episodes: int = 50,
    checkpoint: Checkpoint = "best",
    workers: Workers = 0,
    seed: int = 0,
    json: Json = False,
) -> int:
    """Compare two runs, or two folders of runs that differ in the seed, on the same fresh episodes.

    The interval of the difference is Welch's; p is that of a permutation test. Needs SciPy (extra study).

    shes compare runs/base runs/sweep/sigma-0.05

    Args:
        measure: What is compared.
        episodes: Episodes of each run.
        seed: Seed of the episodes.
    """
    found = compare_runs(
        first,
        second,
        episodes=episodes,
        checkpoint=checkpoint,
        measure=measure,
        num_workers=workers,
        seed=seed,
    )
    if json:
        print_facts({"first": first, "second": second, **asdict(found)}, as_json=True)
        return 0
    rows = [
        (first, f"{found.first_mean:.3f}", str(found.first_count)),
        (second, f"{found.second_mean:.3f}", str(found.second_count)),
    ]
    print_table(("run", f"mean {measure}", found.unit), rows)
    print_line(
        f"difference {found.difference:+.3f}, 95 % interval [{found.low:+.3f}, {found.high:+.3f}], p {found.p:.4f}"
    )
    if found.unit == "episodes":
        print_line(
            "Over episodes: this says nothing of other seeds of training. Compare folders of several seeds for that."
        )
    return 0
