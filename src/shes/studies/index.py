"""The studies that `shes experiment` runs, by name."""

from __future__ import annotations

from typing import Protocol

from shes.studies.ablation import ablation
from shes.studies.learning import learning
from shes.studies.study import Study

__all__ = ["STUDIES", "StudyMaker"]


class StudyMaker(Protocol):
    """Makes a study of a size."""

    def __call__(self, scale: str = "laptop", seeds: int | None = None) -> Study:
        """Return the cells of the study at `scale`, with so many seeds of every variant."""
        ...


STUDIES: dict[str, StudyMaker] = {"ablation": ablation, "learning": learning}
