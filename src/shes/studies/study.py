"""Studies: sets of runs, the cells, that differ in a few settings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from shes.errors import ConfigError, UnknownNameError
from shes.runs.config import TrainConfig
from shes.settings import Ge, Le
from shes.studies.design import StudyDesign
from shes.studies.study_tables import Cell, CellResults
from shes.training.make_config import make_config

CHECKPOINTS = ("best", "last")
"""Checkpoints that are evaluated on fresh episodes at the end of a cell."""
_TRANSFER = ("primitive", "freeze_primitive")
Seeds = Annotated[int, Ge(1), Le(1000)]
"""Number of seeds per variant; every cell is made before the first runs."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """The cells of a study, and what is compared."""

    cells: tuple[Cell, ...]
    episodes: int = 100
    """Number of fresh episodes on which the checkpoints of a finished run are evaluated."""
    design: StudyDesign = field(default_factory=StudyDesign)
    has_large_runs: bool = False
    """Whether every run has all workers for itself; otherwise each has one, and several run at a time."""
    run_cell: Callable[..., CellResults | None] | None = None
    """Function that runs a cell of a study with large runs, in place of `shes.studies.running.run_cell`; it takes no
    `episodes`."""

    def __post_init__(self) -> None:
        """Raise ConfigError if two cells have the same name, or a primitive comes from no cell."""
        names = Counter(cell.name for cell in self.cells)
        for cell in self.cells:
            if names[cell.name] > 1:
                raise ConfigError(f"two cells of the study are called {cell.name}: give one another variant.")
            if cell.primitive is not None and cell.primitive not in self.cells:
                raise ConfigError(
                    f"{cell.name} begins with the primitive of {cell.primitive.name}, which is not "
                    "a cell of the study with these settings."
                )

    def stages(self) -> tuple[tuple[Cell, ...], ...]:
        """Return the cells in stages: a cell comes after the one whose primitive it takes, and as late as possible.

        A stage is ordered by seed, so that a stopped study has about as many seeds of every variant.
        """
        followers: dict[str | None, list[Cell]] = {}
        for cell in self.cells:
            followers.setdefault(None if cell.primitive is None else cell.primitive.name, []).append(cell)

        def height(cell: Cell) -> int:
            return max((1 + height(follower) for follower in followers.get(cell.name, ())), default=0)

        heights = {cell.name: height(cell) for cell in self.cells}
        ordered = sorted(self.cells, key=lambda cell: cell.seed)
        return tuple(
            tuple(cell for cell in ordered if heights[cell.name] == level)
            for level in sorted(set(heights.values()), reverse=True)
        )

    def ordered(self) -> list[Cell]:
        """Return the cells in the order of execution."""
        return [cell for stage in self.stages() for cell in stage]


def choose(study: Study, parts: Sequence[str] | None) -> Study:
    """Return `study` with the cells of `parts`, which are groups or environments, at least one; with all if None.

    Groups come with the base, and cells with those whose primitive they take.
    """
    if parts is None:
        return study
    known = {**study.design.groups, **dict.fromkeys(sorted({cell.env for cell in study.cells}))}
    if not parts:
        raise ConfigError(f"--only needs at least one of {', '.join(known)}. Omit it to run all.")
    for part in parts:
        if part not in known:
            raise UnknownNameError("group or environment", part, known, "Set --only.")
    groups, envs = set(parts) & study.design.groups.keys(), set(parts) - study.design.groups.keys()
    chosen = {
        part.name
        for cell in study.cells
        if (not envs or cell.env in envs)
        and (not groups or cell.group in groups or (cell.group, cell.variant) == study.design.base)
        for part in (cell, cell.primitive)
        if part is not None
    }
    return replace(study, cells=tuple(cell for cell in study.cells if cell.name in chosen))


ALONE: Mapping[str, Any] = MappingProxyType({"backend": "serial", "num_workers": 1})
"""Settings of a run that is its own worker."""


def cell_workers(cell: Cell, workers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings `workers` of a run, in which those of its cell take precedence."""
    return {name: cell.settings.get(name, value) for name, value in workers.items()}


def cell_config(cell: Cell, out: Path, workers: Mapping[str, Any] = ALONE) -> TrainConfig:
    """Return the settings of the run of `cell` in the study at `out`, in which the run of its primitive exists."""
    transfer = {} if cell.primitive is None else {"primitive": out / cell.primitive.name}
    own = {**transfer, "seed": cell.seed, **cell_workers(cell, workers)}
    return make_config(cell.env, cell.preset, {**cell.settings, **own})


def planned_config(cell: Cell) -> TrainConfig:
    """Return the settings of a cell's run before its primitive is there: a frozen one plays no branches.

    Without the primitive's view, a search for a way would be refused; it is left out.
    """
    settings = {name: value for name, value in cell.settings.items() if name not in _TRANSFER}
    if cell.primitive is not None:
        settings = {name: value for name, value in settings.items() if not name.startswith("explore")}
    if cell.primitive is not None and cell.settings.get("freeze_primitive", True):
        settings["primitive_estimate"] = "episode"
    return make_config(cell.env, cell.preset, settings)


def cell_steps(cell: Cell, episodes: int) -> tuple[int, int]:
    """Return the environment steps of a cell's training, and those of its evaluations, if no episode ends early."""
    config = planned_config(cell)
    per_generation, generations = generation_steps(config), config.run.generations
    if config.run.env_steps is not None:
        generations = min(generations, math.ceil(config.run.env_steps / per_generation))
    training = generations * per_generation
    evaluations = 1 + generations // config.evaluation.evaluation_interval
    evaluated = evaluations * config.evaluation.evaluation_episodes + (len(CHECKPOINTS) + 1) * episodes
    return training, evaluated * config.evaluation_steps


def generation_steps(config: TrainConfig) -> int:
    """Return the environment steps of a generation if no episode ends early."""
    return config.algorithm.steps_per_generation(config)
