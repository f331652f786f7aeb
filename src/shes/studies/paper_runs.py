"""The runs of the paper's experiments: methods, tasks and seeds of a scale as cells of a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shes.studies.design import whole
from shes.studies.paper_scales import OF_PRIMITIVE, STEPS, STEPS_TASK, TASKS, Scale
from shes.studies.study import generation_steps
from shes.studies.study_tables import Cell
from shes.training.make_config import make_config

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
            preset = size.preset_of(body, form)
            settings = {**settings, **size.settings, **training, **_budget(env, steps)}
            if body in size.evaluations:
                settings["evaluation_interval"] = _interval(env, preset, settings, size.evaluations[body])
        return Cell(
            group=group, variant=form, env=env, seed=seed, settings=settings, primitive=primitive, preset=preset
        )

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


def _interval(env: str, preset: str, settings: Mapping[str, Any], evaluations: int) -> int:
    """Return the generations between evaluations, for so many in a run, whose form says how long a generation is."""
    alone = {name: value for name, value in settings.items() if name != "freeze_primitive"}
    return whole(settings["env_steps"] / evaluations / generation_steps(make_config(env, preset, alone)))


def _budget(env: str, env_steps: Mapping[str, int]) -> dict[str, int]:
    """Return the settings of a run of so many steps; none if `env_steps` does not name the environment."""
    return {"env_steps": env_steps[env], "generations": 100_000} if env in env_steps else {}
