"""The paper's experiments: Table I, and Figures 3 to 6.

Each compares the paper's method as published with the same method with the learning changes of `docs/learning.md`:
egocentric views, the body's symmetry, a primitive evaluated by branched intervals. In one folder, the experiments
share their runs.

Source: SHES paper, section III and Table I.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated, Any, Literal

from shes.checked import checked
from shes.runs.sections import RunSettings, sections_of, settings_in
from shes.settings import Choices
from shes.studies.design import (
    Curve,
    CurvePanel,
    Curves,
    Forest,
    Measure,
    Reference,
    Speedup,
    StudyDesign,
    within,
)
from shes.studies.paper_runs import HIRO, METHODS, SPEEDUP, STEPWISE, TRANSFER, WORKERS, make_runs, stepwise_runs
from shes.studies.paper_scales import (
    PIECES,
    PUBLISHED,
    REFERENCES,
    SCALES,
    STEPS,
    STEPS_TASK,
    TASKS,
    WITH_OTHER_GOALS,
    Scale,
)
from shes.studies.speedup_cells import MOST, run_speedup
from shes.studies.study import Seeds, Study
from shes.studies.study_tables import Cell

FLAT = "es"
_GROUPS = {
    METHODS: "controller and primitive together from scratch: as published, and with the learning changes",
    STEPWISE: "from the form as published to the one with the learning changes, one change at a time, in Gather",
    TRANSFER: "the same with a primitive that was trained alone (SHES-TL)",
    WORKERS: "the same as from scratch with several numbers of workers",
    SPEEDUP: "the time of a generation on more cores",
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
    "equivariant": "… and an equivariant controller",
    PIECES: "with the learning changes",
    HIRO: "HIRO",
}
_SMALL_WORDS = {**_WORDS, **{variant: f"{_WORDS[variant]}, small" for variant in (PUBLISHED, HIRO)}}
"""Names at scales whose networks, populations and budgets are not those of Table I."""
_SCORE, _TRAINING = (
    Measure("score_mean", "test score"),
    Measure("training_return_mean", "training reward, perturbed policies"),
)
_OF_PRIMITIVE = Measure("primitive_return_mean", "test return of the primitive")
_BEST = Measure("best_score", "score of the best checkpoint", "score")
_SECONDS = Measure("seconds", "seconds of a run", "s")
_PUBLISHED_NOTE = (
    "published, after 10 million steps in the authors' own environments, without waypoints (Nachum et al. 2018); SHES: "
    "1.24 times HIRO's, as in its paper"
)
_HIRO_STEPS_PER_S = 1_000  # of one core, with ten updates after ten steps; measured: 930 to 1,430
_HIRO_PAIR = ((METHODS, HIRO), (METHODS, PIECES))


def table_1(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of Table I, which are those of figure 3; otherwise as `figure_3`."""
    return _scores(_size(scale, seeds), (Forest(file="table1.png", group=METHODS),))


def figure_3(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of figure 3: the test score of SHES, of the steps between its forms, and of HIRO.

    Raises:
        UnknownNameError: There is no such scale: `paper` needs a cluster, `laptop` hours of two cores, `smoke` minutes.
        ConfigError: `seeds` is not from 1 to 1000.
    """
    size = _size(scale, seeds)
    words = _words(size)
    curves = [Curve(METHODS, form, f"SHES {words[form]}") for form in _FORMS] + [Curve(METHODS, HIRO, words[HIRO])]
    figures = (
        _curves("fig3-env-steps", size, curves, _SCORE, "env_steps", REFERENCES),
        _curves("fig3-hours", size, curves, _SCORE, "hours", REFERENCES),
        _step_curves(size),
    )
    return _scores(size, figures)


def _scores(size: Scale, figures: tuple[Forest | Curves, ...]) -> Study:
    """Return the study of all methods from scratch."""
    cells = [*make_runs(size, {METHODS: (*_FORMS, HIRO)}), *stepwise_runs(size)]
    study = _study(size, cells, _SCORE, paired=(_HIRO_PAIR,), figures=figures)
    steps = {
        f"{body}-{STEPS_TASK}": (
            *within(STEPWISE, *itertools.pairwise(forms)),
            ((METHODS, PIECES), (STEPWISE, forms[-1])),  # so that it is one of the comparisons of the steps
        )
        for body, forms in STEPS.items()
    }
    return replace(study, design=replace(study.design, paired_on=steps))


def figure_4(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of figure 4: the training reward at several numbers of workers; otherwise as `figure_3`."""
    size = _size(scale, seeds, is_timed=True)
    variants = {f"{form}-{number}": (form, number) for form in _FORMS for number in size.num_workers}
    words = _words(size)
    labels = {
        variant: f"{words[form]}, {number} worker{'s' * (number > 1)}" for variant, (form, number) in variants.items()
    }
    cells = [
        replace(cell, group=WORKERS, variant=variant, settings={**cell.settings, "num_workers": number})
        for cell in make_runs(size, {METHODS: _FORMS})
        for variant, (form, number) in variants.items()
        if form == cell.variant
    ]
    curves = [Curve(WORKERS, variant, f"SHES {label}") for variant, label in labels.items()]
    fewest, *more = size.num_workers
    pairs = [(f"{PIECES}-{fewest}", f"{PIECES}-{number}") for number in more]
    pairs += [(f"{PUBLISHED}-{number}", f"{PIECES}-{number}") for number in more]
    return _study(
        size,
        cells,
        _TRAINING,
        metric=_SECONDS,
        labels=labels,
        paired=within(WORKERS, *pairs),
        figures=(_curves("fig4", size, curves, _TRAINING, "hours"),),
        has_large_runs=True,
        has_ratios=True,
    )


def figure_5(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of figure 5: the training reward of SHES and SHES-TL; otherwise as `figure_3`."""
    size, names = _size(scale, seeds), {METHODS: "SHES", TRANSFER: "SHES-TL"}
    curves = [
        Curve(group, form, f"{name} {_words(size)[form]}", is_after_primitive=group == TRANSFER)
        for group, name in names.items()
        for form in _FORMS
    ]
    return _study(
        size,
        make_runs(size, dict.fromkeys(names, _FORMS)),
        _TRAINING,
        paired=(*within(TRANSFER, (PUBLISHED, PIECES)), ((METHODS, PIECES), (TRANSFER, PIECES))),
        figures=(
            _curves("fig5-env-steps", size, curves, _TRAINING, "env_steps"),
            _curves("fig5-hours", size, curves, _TRAINING, "hours"),
            _curves("fig5-score", size, curves, _SCORE, "env_steps"),
        ),
    )


def figure_6(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the measurements of figure 6: the speed-up of SHES and S-ES by more cores; otherwise as `figure_3`."""
    size, cells = _size(scale, seeds, is_timed=True), list[Cell]()
    if size.timed_scale is not None:
        one = {"ant": seeds or 1}  # a generation takes as long with every seed
        size = replace(SCALES[size.timed_scale], seeds=one)
    for run in make_runs(size, {METHODS: _FORMS}):
        if run.env == size.timed_env:
            settings = {name: value for name, value in run.settings.items() if name not in ("env_steps", "minutes")}
            cell = replace(run, group=SPEEDUP, settings={**settings, "generations": 1})
            flat = {**_settings_of(cell.env, FLAT, cell.settings), "algorithm": FLAT}
            cells += [cell, *([replace(cell, variant=FLAT, settings=flat)] if cell.variant == PUBLISHED else [])]
    labels = {PUBLISHED: "SHES as published", PIECES: "SHES with the learning changes", FLAT: "S-ES"}
    study = _study(
        size,
        cells,
        Measure("speedup", "speed-up"),
        figures=(Speedup(file="fig6.png", group=SPEEDUP),),
        metric=Measure(f"speedup_{MOST}", f"speed-up projected to {MOST} cores", "speed-up"),
        labels=labels,
        has_large_runs=True,
        has_ratios=True,
        has_equal_budgets=False,
    )
    return replace(study, episodes=0, run_cell=run_speedup)


def _settings_of(env: str, algorithm: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of `settings` that `algorithm` has on `env`."""
    own = settings_in(sections_of(RunSettings.of({"env": env, "algorithm": algorithm})).values())
    return {name: value for name, value in settings.items() if name in own}


@checked
def _size(scale: Annotated[str, Choices(SCALES)], seeds: Seeds | None, *, is_timed: bool = False) -> Scale:
    """Return the scale of this name, with `seeds` seeds."""
    size = SCALES[scale]
    if is_timed:
        size = replace(size, seeds=size.timed_seeds or size.seeds, env_steps={**size.env_steps, **size.timed_env_steps})
    return size if seeds is None else replace(size, seeds=dict.fromkeys(size.seeds, seeds))


def _words(size: Scale) -> Mapping[str, str]:
    """Return the names of the variants at a scale."""
    return _WORDS if size.preset == "paper" else _SMALL_WORDS


# Comparisons and figures.


def _study(
    size: Scale,
    cells: Sequence[Cell],
    curve: Measure,
    *,
    figures: tuple[Forest | Curves | Speedup, ...],
    metric: Measure = _BEST,
    labels: Mapping[str, str] | None = None,
    paired: tuple[tuple[tuple[str, str], tuple[str, str]], ...] = (),
    has_large_runs: bool = False,
    has_ratios: bool = False,
    has_equal_budgets: bool = True,
) -> Study:
    """Return the study of `cells`, compared with the variant of the first one."""
    envs = [env for env in dict.fromkeys(cell.env for cell in cells) if not env.endswith("flagrun")]
    variants, labels = dict.fromkeys(cell.variant for cell in cells), labels or _words(size)
    design = StudyDesign(
        groups={group: _GROUPS[group] for group in dict.fromkeys(cell.group for cell in cells)},
        base=(cells[0].group, cells[0].variant),
        metrics=dict.fromkeys(envs, metric),
        curves=dict.fromkeys(envs, curve),
        labels={variant: labels[variant] for variant in variants},
        paired=paired,
        figures=figures,
        formats=("svg", "png"),
        has_ratios=has_ratios,
        has_equal_budgets=has_equal_budgets,
        slower=MappingProxyType({HIRO: _HIRO_STEPS_PER_S} if HIRO in variants else {}),
    )
    return Study(
        cells=tuple(cells),
        episodes=size.episodes,
        design=design,
        has_large_runs=has_large_runs or size.preset == "paper",
    )


def _step_curves(size: Scale) -> Curves:
    """Return a figure of the steps between the two forms: for each body the score, and the primitive's return."""

    def panel(body: str, measure: Measure) -> CurvePanel:
        steps = [Curve(STEPWISE, form) for form in STEPS[body]]
        if measure is _OF_PRIMITIVE:  # the return of one that has other goals cannot be compared
            steps = [curve for curve in steps if curve.variant not in WITH_OTHER_GOALS]
        last = [] if measure is _OF_PRIMITIVE else [Curve(METHODS, PIECES)]
        curves = [Curve(METHODS, PUBLISHED), *steps, *last]
        title = f"{body} {STEPS_TASK}".title() + ", step by step"
        return CurvePanel(env=f"{body}-{STEPS_TASK}", title=title, curves=tuple(curves), measure=measure)

    panels = tuple(panel(body, measure) for body in size.seeds for measure in (_SCORE, _OF_PRIMITIVE))
    return Curves(file="fig3-steps.png", groups=(STEPWISE,), panels=panels, columns=2)


def _curves(
    file: str,
    size: Scale,
    curves: Sequence[Curve],
    measure: Measure,
    x: Literal["env_steps", "hours"],
    references: Mapping[str, tuple[Reference, ...]] = MappingProxyType({}),
) -> Curves:
    """Return a figure with a panel per task; one of test scores also has their running best."""
    panels = tuple(
        CurvePanel(
            env=f"{body}-{task}",
            title=f"{body} {task}".title(),
            curves=tuple(curves),
            measure=measure,
            x=x,
            references=references.get(f"{body}-{task}", ()),
            has_running_best=measure is _SCORE,
        )
        for body in size.seeds
        for task in TASKS
    )
    groups = tuple(dict.fromkeys(curve.group for curve in curves))
    return Curves(file=f"{file}.png", groups=groups, panels=panels, columns=len(TASKS), references_note=_PUBLISHED_NOTE)
