"""The finished results of a study by environment, group and variant, as its figures need them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from shes.studies.comparison import Comparison
from shes.studies.study import Study
from shes.studies.study_tables import Cell, CellResults
from shes.types import F64Array

Place = tuple[str, str, str]
"""Environment, group, variant."""


class PlacedResults:
    """The results of a study by place, ordered by seed."""

    def __init__(self, study: Study, summaries: Mapping[str, CellResults], comparisons: Sequence[Comparison]) -> None:
        self.design = study.design
        self.summaries: dict[Place, list[CellResults]] = {}
        self.cells: dict[Place, Cell] = {}
        for cell in study.cells:
            place = (cell.env, cell.group, cell.variant)
            self.cells[place] = cell
            if cell.name in summaries:
                self.summaries.setdefault(place, []).append(summaries[cell.name])
        self._p = {
            (c.env, c.group, c.variant): c.p_holm
            for c in comparisons
            if (c.against_group, c.against) == study.design.base
        }

    def scores(self, place: Place) -> F64Array:
        """Return the compared measure of every seed."""
        column = self.design.metrics[place[0]].column
        return np.array([summary.row[column] for summary in self.summaries.get(place, ())], dtype=np.float64)

    def p(self, place: Place) -> str:
        """Return the corrected p against the base as text; beside the base itself, the heading."""
        p = self._p.get(place)
        if p is None:
            return "against base" if place[1:] == self.design.base else ""
        return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"

    def has(self, *groups: str) -> bool:
        """Return whether a cell of one of `groups`, other than the base, is finished."""
        return any(place[1] in groups and place[1:] != self.design.base for place in self.summaries)

    def variants(self, env: str, group: str) -> list[Place]:
        """Return the base of `env` and the variants of `group` that have finished runs, in the order of the study."""
        own = [place for place in self.cells if place[:2] == (env, group) and place[1:] != self.design.base]
        return [place for place in ((env, *self.design.base), *own) if place in self.summaries]
