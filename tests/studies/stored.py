"""The paper's experiments whose results are in `results/paper`: their runs had settings of earlier versions.

The ant with the learning changes had the views that were removed since and ways drawn by hand, and every method these
ways; the last step of Figure 3 was the view `patrol`.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

from shes.studies.study import Study
from shes.studies.study_tables import Cell, CellResults, read_tables

RENAMED = {"equivariant": "patrol"}
"""Variants of today, and those whose results are stored in their place."""


@cache
def _digests(out: Path) -> dict[tuple[str, ...], str]:
    with (out / "runs.csv").open(newline="", encoding="utf-8") as file:
        return {
            tuple(row[name] for name in ("group", "variant", "env")): row["settings"] for row in csv.DictReader(file)
        }


def stored_summaries(study: Study, out: Path) -> dict[str, CellResults]:
    """Return the results at `out` by the names of the cells of `study`, whatever the settings of their runs."""
    stored: dict[str, Cell] = {}
    for cell in study.cells:
        earlier = replace(cell, variant=RENAMED.get(cell.variant, cell.variant))
        # A digest is computed once, so that it can be set.
        earlier.__dict__["digest"] = _digests(out)[earlier.group, earlier.variant, earlier.env]
        stored[cell.name] = earlier
    tables = read_tables(list(stored.values()), out)
    return {name: tables[earlier.name] for name, earlier in stored.items()}
