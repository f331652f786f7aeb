"""`shes compare`: the difference between runs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from shes.cli.output import print_facts, print_line, print_table
from shes.cli.parsing import Json
from shes.studies.run_comparison import compare_runs


def compare(*, json: Json = False, **options: Annotated[Any, "shes.studies.run_comparison.compare_runs"]) -> int:
    """Compare two runs, or two folders of runs that differ in the seed, on the same fresh episodes.

    The interval of the difference is Welch's; p is that of a permutation test. Needs SciPy (extra study).

    shes compare runs/base runs/sweep/sigma-0.05
    """
    found = compare_runs(**options)
    first, second = options["first"], options["second"]
    if json:
        print_facts({"first": first, "second": second, **asdict(found)}, as_json=True)
        return 0
    rows = [
        (first, f"{found.first_mean:.3f}", str(found.first_count)),
        (second, f"{found.second_mean:.3f}", str(found.second_count)),
    ]
    print_table(("run", f"mean {found.measure}", found.unit), rows)
    print_line(
        f"difference {found.difference:+.3f}, 95 % interval [{found.low:+.3f}, {found.high:+.3f}], p {found.p:.4f}"
    )
    if found.unit == "episodes":
        print_line(
            "Over episodes: this says nothing of other seeds of training. Compare folders of several seeds for that."
        )
    return 0
