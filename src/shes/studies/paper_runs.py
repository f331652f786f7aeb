"""The runs of the paper's experiments: methods, tasks and seeds of a scale as cells of a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from shes.studies.design import whole
from shes.studies.paper_scales import OF_PRIMITIVE, STEPS, STEPS_TASK, TASKS, Scale
from shes.studies.study import generation_steps, planned_config
from shes.studies.study_tables import Cell

METHODS, STEPWISE, TRANSFER, WORKERS, SPEEDUP = "methods", "steps", "transfer", "workers", "speedup"
"""Groups of runs."""
HIRO = "hiro"


def make_runs(size: Scale, groups: Mapping[str, tuple[str, ...]]) -> list[Cell]:
    """Return the runs of these forms of each group, on all tasks."""
    return [
        cell
        for body, seeds in size.seeds.items()
        for seed in range(1, 1 + seeds)
        for group, forms in groups.items()
        for form in forms
        for cell in _cells(size, body, group, form, seed)
    ]


def _cells(size: Scale, body: str, group: str, form: str, seed: int) -> Iterator[Cell]:
    """Yield the runs of a method on the tasks of a body; with transfer, the primitive's run first."""

    def cell(task: str, settings: Mapping[str, Any], primitive: Cell | None = None) -> Cell:
        env, preset = f"{body}-{task}", size.preset
        training = size.training(task)
        if form == HIRO:
            settings = {"algorithm": "hiro", **size.hiro, **training, **_budget(env, size.hiro_env_steps)}
            preset = size.hiro_preset
        else:
            steps = size.env_steps if primitive is None else {**size.env_steps, **size.transfer_env_steps}
            preset = size.preset_of(form)
            settings = {**settings, **size.settings, **training, **_budget(env, steps)}
        made = Cell(
            group=group, variant=form, env=env, seed=seed, settings=settings, primitive=primitive, preset=preset
        )
        return made if form == HIRO or body not in size.evaluations else _evaluated(made, size.evaluations[body])

    if form == HIRO:
        yield from (cell(task, {}) for task in TASKS)
        return
    if group == STEPWISE:
        yield cell(STEPS_TASK, size.form(body, STEPS_TASK, form))
        return
    forms = {task: size.form(body, task, form) for task in (*TASKS, "flagrun")}
    if group == METHODS:
        yield from (cell(task, forms[task]) for task in TASKS)
        return
    walker = cell("flagrun", forms["flagrun"])
    yield walker
    for task in TASKS:
        own = {
            name: value
            for name, value in forms[task].items()
            if name not in OF_PRIMITIVE and not name.startswith("primitive_")
        }
        yield cell(task, own, walker)


def stepwise_runs(size: Scale) -> list[Cell]:
    """Return the runs of the steps between the two forms, each on the task of its body."""
    return [
        cell
        for body, seeds in size.seeds.items()
        for seed in range(1, 1 + seeds)
        for form in STEPS[body]
        for cell in _cells(size, body, STEPWISE, form, seed)
    ]


def _evaluated(cell: Cell, evaluations: int) -> Cell:
    """Return `cell` with about so many evaluations, whatever the length of its generations."""
    interval = whole(cell.settings["env_steps"] / evaluations / generation_steps(planned_config(cell)))
    return replace(cell, settings={**cell.settings, "evaluation_interval": interval})


def _budget(env: str, env_steps: Mapping[str, int]) -> dict[str, int]:
    """Return the settings of a run of so many steps; none if `env_steps` does not name the environment."""
    return {"env_steps": env_steps[env], "generations": 100_000} if env in env_steps else {}
