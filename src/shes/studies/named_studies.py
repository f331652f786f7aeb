"""The studies that `shes experiment` runs, by name."""

from __future__ import annotations

from collections.abc import Callable

from shes.studies.ablation import ablation
from shes.studies.paper import figure_3, figure_4, figure_5, figure_6, table_1
from shes.studies.study import Study
from shes.studies.walker_study import learning

STUDIES: dict[str, Callable[[str, int | None], Study]] = {
    "ablation": ablation,
    "learning": learning,
    "table1": table_1,
    "fig3": figure_3,
    "fig4": figure_4,
    "fig5": figure_5,
    "fig6": figure_6,
}
"""Functions of the scale and the number of seeds."""
