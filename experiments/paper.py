"""The paper's experiments: Table I and Figures 3 to 5; `figure6` has the last one.

Each compares the paper's method as published with the same method with the learning changes of `docs/learning.md`. In
one folder, the experiments share their runs.

Source: SHES paper, section III and Table I.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal

from experiments.curve_figure import Curve, Panel, draw_curves
from experiments.design import DrawFigure, Experiment, Measure, Pair, Run, find_size, generation_steps, whole, within
from experiments.paper_settings import (
    OF_PRIMITIVE,
    PIECES,
    PUBLISHED,
    REFERENCES,
    SCALES,
    STEPS,
    STEPS_TASK,
    TASKS,
    Scale,
)

METHODS, STEPWISE, TRANSFER, WORKERS = "methods", "steps", "transfer", "workers"
"""Groups of runs."""
HIRO = "hiro"
_GROUPS = {
    METHODS: "controller and primitive together from scratch: as published, and with the learning changes",
    STEPWISE: "from the form as published to the one with the learning changes, one change at a time, in Gather",
    TRANSFER: "the same with a primitive that was trained alone (SHES-TL)",
    WORKERS: "the same as from scratch with several numbers of workers",
}
_FORMS = (PUBLISHED, PIECES)
_WORDS = {
    PUBLISHED: "as published",
    "views": "as published, and egocentric views",
    "symmetry": "… and the body's symmetry",
    "branches": "… and branched intervals",
    "ties": "… and output layers at zero, no update of ties",
    "gait": "… and a clock, a price of falls, output layers at zero",
    "goals": "… and goals of 1 s at full distance",
    "equivariant": "… and an equivariant controller, a linear primitive",
    PIECES: "with the learning changes",
    HIRO: "HIRO",
}
_SHORT = {PUBLISHED: "published", PIECES: "with changes"}
"""The same at a line of a figure."""
_SCORE, _TRAINING = (
    Measure("score_mean", "test score"),
    Measure("training_return_mean", "training reward, perturbed policies"),
)
_BEST = Measure("best_score", "score of the best checkpoint")
_SECONDS = Measure("seconds", "seconds of a run")
_PUBLISHED_NOTE = (
    "published, after 10 million steps in the authors' own environments, without waypoints (Nachum et al. 2018); SHES: "
    "1.24 times HIRO's, as in its paper"
)


def figure_3(scale: str = "laptop", seeds: int | None = None) -> Experiment:
    """Return the runs of Table I and figure 3: SHES, the steps between its forms, and HIRO."""
    size = _size(scale, seeds)
    pairs = [Pair((METHODS, HIRO), (METHODS, PIECES))]
    for body, forms in STEPS.items():
        env = f"{body}-{STEPS_TASK}"
        pairs += [Pair((STEPWISE, first), (STEPWISE, second), env) for first, second in pairwise(forms)]
        pairs.append(Pair((METHODS, PIECES), (STEPWISE, forms[-1]), env))  # as one of the comparisons of the steps
    curves = [Curve(METHODS, form, f"SHES {_SHORT[form]}") for form in _FORMS] + [Curve(METHODS, HIRO, _WORDS[HIRO])]
    figures = {
        "fig3-env-steps.png": _curves(size, curves, _SCORE, "env_steps", REFERENCES),
        "fig3-hours.png": _curves(size, curves, _SCORE, "seconds", REFERENCES),
        "fig3-steps.png": _step_curves(size),
    }
    runs = _all_runs(size, lambda body: {METHODS: (*_FORMS, HIRO), STEPWISE: STEPS[body]})
    return _experiment(size, runs, pairs=tuple(pairs), figures=figures)


def figure_4(scale: str = "laptop", seeds: int | None = None) -> Experiment:
    """Return the runs of figure 4: the training reward at several numbers of workers."""
    size = _size(scale, seeds, is_timed=True)
    variants = {f"{form}-{number}": (form, number) for form in _FORMS for number in size.num_workers}
    labels = {name: f"{_WORDS[form]}, {count} worker{'s' * (count > 1)}" for name, (form, count) in variants.items()}
    runs = [
        replace(run, group=WORKERS, variant=variant, settings={**run.settings, "num_workers": number})
        for run in _all_runs(size, lambda _: {METHODS: _FORMS})
        for variant, (form, number) in variants.items()
        if form == run.variant
    ]
    curves = [Curve(WORKERS, name) for name in labels]
    fewest, *more = size.num_workers
    pairs = [(f"{PIECES}-{fewest}", f"{PIECES}-{number}") for number in more]
    pairs += [(f"{PUBLISHED}-{number}", f"{PIECES}-{number}") for number in more]
    experiment = _experiment(
        size,
        runs,
        metric=_SECONDS,
        pairs=within(WORKERS, *pairs),
        figures={"fig4.png": _curves(size, curves, _TRAINING, "seconds")},
    )
    return replace(experiment, labels=labels, has_large_runs=True, has_ratios=True)


def figure_5(scale: str = "laptop", seeds: int | None = None) -> Experiment:
    """Return the runs of figure 5: the training reward of SHES and SHES-TL."""
    size, names = _size(scale, seeds), {METHODS: "SHES", TRANSFER: "SHES-TL"}
    curves = [
        Curve(group, form, f"{name} {_SHORT[form]}", is_after_primitive=group == TRANSFER)
        for group, name in names.items()
        for form in _FORMS
    ]
    return _experiment(
        size,
        _all_runs(size, lambda _: dict.fromkeys(names, _FORMS)),
        pairs=(*within(TRANSFER, (PUBLISHED, PIECES)), Pair((METHODS, PIECES), (TRANSFER, PIECES))),
        figures={
            "fig5-hours.png": _curves(size, curves, _TRAINING, "seconds"),
            "fig5-score.png": _curves(size, curves, _SCORE, "env_steps"),
        },
    )


def _size(scale: str, seeds: int | None, *, is_timed: bool = False) -> Scale:
    """Return the scale of this name, with `seeds` seeds."""
    size = find_size(scale, SCALES, seeds)
    if is_timed:
        size = replace(size, seeds=size.timed_seeds or size.seeds, env_steps={**size.env_steps, **size.timed_env_steps})
    return size if seeds is None else replace(size, seeds=dict.fromkeys(size.seeds, seeds))


# Runs.


def _all_runs(size: Scale, groups: Callable[[str], Mapping[str, tuple[str, ...]]]) -> list[Run]:
    """Return the runs of the forms in each group, which are a function of the body, on all tasks."""
    return [
        run
        for body, seeds in size.seeds.items()
        for seed in range(1, 1 + seeds)
        for group, forms in groups(body).items()
        for form in forms
        for run in _runs(size, body, group, form, seed)
    ]


def _runs(size: Scale, body: str, group: str, form: str, seed: int) -> Iterator[Run]:
    """Yield the runs of a form; with transfer, the primitive's run first."""
    made = Run(group=group, variant=form, env="", seed=seed)
    if form == HIRO:
        for task in TASKS:
            env = f"{body}-{task}"
            settings = {"algorithm": "hiro", **size.hiro, **size.training(task), **_budget(env, size.hiro_env_steps)}
            yield replace(made, env=env, settings=settings, preset=size.hiro_preset)
        return
    if group != TRANSFER:
        for task in (STEPS_TASK,) if group == STEPWISE else TASKS:
            yield _of_shes(size, replace(made, env=f"{body}-{task}"), size.form(body, task, form))
        return
    walker = _of_shes(size, replace(made, env=f"{body}-flagrun"), size.form(body, "flagrun", form))
    yield walker
    for task in TASKS:
        own = {
            name: value
            for name, value in size.form(body, task, form).items()
            if name not in OF_PRIMITIVE and not name.startswith("primitive_")
        }
        yield _of_shes(size, replace(made, env=f"{body}-{task}", primitive=walker), own)


def _of_shes(size: Scale, run: Run, settings: Mapping[str, Any]) -> Run:
    """Return a run of SHES with these settings, as long as those of the scale, evaluated as often as they are."""
    body, _, task = run.env.partition("-")
    steps = size.env_steps if run.primitive is None else {**size.env_steps, **size.transfer_env_steps}
    settings = {**settings, **size.settings, **size.training(task), **_budget(run.env, steps)}
    run = replace(run, settings=settings, preset=size.preset_of(run.variant))
    if body not in size.evaluations:
        return run
    config = run.planned_config()
    generations = settings["env_steps"] / generation_steps(config)
    interval = whole(generations / size.evaluations[body])
    return replace(run, settings={**settings, "evaluation_interval": interval})


def _budget(env: str, env_steps: Mapping[str, int]) -> dict[str, int]:
    """Return the settings of a run of so many steps; none if `env_steps` does not name the environment."""
    return {"env_steps": env_steps[env], "generations": 100_000} if env in env_steps else {}


# Comparisons and figures.


def _experiment(
    size: Scale,
    runs: Sequence[Run],
    *,
    figures: Mapping[str, DrawFigure],
    metric: Measure = _BEST,
    pairs: tuple[Pair, ...] = (),
) -> Experiment:
    """Return the experiment of `runs`, compared with the variant of the first one."""
    envs = [env for env in dict.fromkeys(run.env for run in runs) if not env.endswith("flagrun")]
    return Experiment(
        runs=tuple(runs),
        groups={group: _GROUPS[group] for group in dict.fromkeys(run.group for run in runs)},
        base=(runs[0].group, runs[0].variant),
        metrics=dict.fromkeys(envs, metric),
        labels=_WORDS,
        pairs=pairs,
        figures=figures,
        episodes=size.episodes,
        has_large_runs=size.preset == "paper",
        has_equal_budgets=True,
    )


def _step_curves(size: Scale) -> DrawFigure:
    """Return a figure of the steps between the two forms: a panel for each body."""
    ends = Curve(METHODS, PUBLISHED), Curve(METHODS, PIECES)
    panels = [
        Panel(
            env=f"{body}-{STEPS_TASK}",
            title=f"{body} {STEPS_TASK}".title(),
            curves=(ends[0], *(Curve(STEPWISE, form) for form in STEPS[body]), ends[1]),
            measure=_SCORE,
        )
        for body in size.seeds
    ]
    return partial(draw_curves, panels=panels, columns=2)


def _curves(
    size: Scale,
    curves: Sequence[Curve],
    measure: Measure,
    x: Literal["env_steps", "seconds"],
    references: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> DrawFigure:
    """Return a figure with a panel per task; one of test scores also has their running best."""
    panels = [
        Panel(
            env=f"{body}-{task}",
            title=f"{body} {task}".title(),
            curves=tuple(curves),
            measure=measure,
            x=x,
            references=references.get(f"{body}-{task}", {}),
            has_running_best=measure is _SCORE,
        )
        for body in size.seeds
        for task in TASKS
    ]
    return partial(draw_curves, panels=panels, columns=len(TASKS), references_note=_PUBLISHED_NOTE)
