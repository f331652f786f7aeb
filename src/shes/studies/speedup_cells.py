"""The cells of Figure 6: generations on 1 to N workers are timed, and their time on a cluster is projected.

Source: SHES paper, Figure 6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter, time
from typing import Any

from shes.runs.provenance import provenance
from shes.runs.tables import Row
from shes.studies.provenance_columns import provenance_columns
from shes.studies.study import cell_config
from shes.studies.study_tables import Cell, CellResults
from shes.studies.summaries import read_summary, write_summary

PAPER_CORES = (48, 240, 600)
"""Numbers of cores in the paper."""
MOST = PAPER_CORES[-1]


def run_speedup(
    cell: Cell,
    out: Path,
    *,
    until: float = math.inf,
    workers: Mapping[str, Any],
) -> CellResults | None:
    """Measure the speed-up of a cell's settings and return the summary; None if the time is over. See `run_cell`.

    Args:
        cell: The cell.
        out: Folder of the study.
        until: Time, as of `time.time`, after which no measurement begins.
        workers: Backend, and the largest number of workers that is measured.

    Raises:
        ShesError: Raised by `measure_speedup`.
    """
    summary = read_summary(cell, out)
    if summary is not None:
        return summary
    if time() >= until:
        return None
    from benchmarks import speedup  # of a checkout: it is not part of the package

    start, config = perf_counter(), cell_config(cell, out, workers)
    rows = speedup.measure_speedup(config)
    by_place = {(row["kind"], row["cores"]): row["speedup"] for row in rows}
    most = config.workers.count
    row: Row = {
        **cell.identity,
        "workers": most,
        "speedup_here": by_place["measured", most],
        **{f"speedup_{cores}": by_place["projected", cores] for cores in PAPER_CORES},
        "seconds": perf_counter() - start,
        **provenance_columns([provenance(config.workers.device)]),
    }
    curve = tuple({**cell.identity, **{name: _value(value) for name, value in each.items()}} for each in rows)
    return write_summary(cell, out, CellResults(row=row, curve=curve))


def _value(value: Any) -> Any:
    """Return `value`, but None for a number that is unknown."""
    return None if isinstance(value, float) and math.isnan(value) else value
