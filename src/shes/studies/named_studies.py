"""The studies that `shes experiment` runs, by name."""

from __future__ import annotations

from collections.abc import Callable

from shes.studies.ablation import ablation
from shes.studies.learning import learning
from shes.studies.paper import figure_3, figure_5
from shes.studies.study import Study

STUDIES: dict[str, Callable[[str, int | None], Study]] = {
    "ablation": ablation,
    "learning": learning,
    "fig3": figure_3,
    "fig5": figure_5,
}
"""Functions of the scale and the number of seeds."""
