"""The paper's experiments: SHES against HIRO (figure 3, with the extra `hiro`), and against SHES-TL (figure 5).

Each compares the paper's method as published with the pieces of `docs/learning.md`: egocentric views, the body's
symmetry, a primitive evaluated by branched intervals. In one folder, the two figures share their runs.

Source: SHES paper, section III and Table I.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from shes.settings import Choices, Ge, checked
from shes.studies.design import Curve, CurvePanel, Curves, Measure, Reference, StudyDesign
from shes.studies.study import Study
from shes.studies.study_tables import Cell
from shes.training.presets import make_config

TASKS = ("gather", "maze", "push")
METHODS, TRANSFER = "methods", "transfer"
PUBLISHED, PIECES, HIRO = "published", "pieces", "hiro"
_GROUPS = {
    METHODS: "controller and primitive together from scratch: as published, and with the pieces",
    TRANSFER: "the same with a primitive that was trained alone (SHES-TL)",
}
_WORDS = {PUBLISHED: "as published", PIECES: "with the pieces", HIRO: "HIRO"}
_LABELS = {
    (METHODS, PUBLISHED): "SHES as published",
    (METHODS, PIECES): "SHES with the pieces",
    (METHODS, HIRO): "HIRO",
    (TRANSFER, PUBLISHED): "SHES-TL as published",
    (TRANSFER, PIECES): "SHES-TL with the pieces",
}
_SCORE, _TRAINING = Measure("score_mean", "test score"), Measure("training_return_mean", "training reward")
REFERENCES: dict[str, tuple[Reference, ...]] = {
    "ant-gather": (
        Reference("SHES (paper)", 3.74),
        Reference("HIRO (Nachum)", 3.02),
        Reference("SNN4HRL", 1.92),
        Reference("VIME", 1.42),
        Reference("FuN", 0.85),
    ),
    "ant-maze": (Reference("HIRO (Nachum)", 0.99), Reference("FuN", 0.16), Reference("SNN4HRL, VIME", 0.0)),
    "ant-push": (Reference("HIRO (Nachum)", 0.92), Reference("FuN", 0.06), Reference("SNN4HRL, VIME", 0.02)),
}
"""Published scores: Nachum et al. 2018, Table 1 (FuN with cosine similarity); SHES paper, 1.24 times HIRO's."""

_BRANCHES = {"primitive_estimate": "interval", "intervals": 2}
_VIEWS = {"primitive_view": "egocentric", "goal_encoding": "angle_metres"}
_PLAIN = {"output_weights": "zero", "weight_decay": 0.0}
_POINT: dict[str, Any] = {"controller_interval": 10, "population_size": 160, "sigma": 0.1, "learning_rate": 0.04}
_POINT_BRANCHES = {"primitive_population_size": 400, "primitive_sigma": 0.1, "primitive_learning_rate": 0.03}
_ANT_PUBLISHED: dict[str, Any] = {
    "hidden": (64, 64),
    "population_size": 240,
    "sigma": 0.07,
    "learning_rate": 0.02,
    "noise_table_size": 25_000_000,
}
_FORMS: dict[tuple[str, str], dict[str, Any]] = {
    ("point", PUBLISHED): _POINT,
    ("point", PIECES): {
        **_POINT,
        **_VIEWS,
        **_BRANCHES,
        **_PLAIN,
        **_POINT_BRANCHES,
        "minimum_goal_distance": False,
    },
    ("ant", PUBLISHED): _ANT_PUBLISHED,
    ("ant", PIECES): {},
}
"""Settings over the preset, by body and form. For the ant, the preset `laptop` has the pieces: the form as published is
over `smoke`, which has none."""
_ALONE: dict[tuple[str, str], dict[str, Any]] = {
    ("point", PUBLISHED): _POINT,
    ("point", PIECES): {**_POINT, **_VIEWS, **_BRANCHES, **_PLAIN, "population_size": 400, "learning_rate": 0.03},
    ("ant", PUBLISHED): _ANT_PUBLISHED,
    ("ant", PIECES): {},
}
"""The same for a primitive that is trained alone."""
_PIECES = (
    *("primitive_view", "symmetry", "goal_encoding", "clock_frequency", "primitive_estimate", "intervals"),
    *("fall_price", "output_weights", "weight_decay", "hold_tied", "controller_view", "controller_output"),
    *("minimum_goal_distance", "primitive_population_size", "primitive_sigma", "primitive_learning_rate"),
)
"""Settings that are pieces; the others of a preset say how large networks and population are."""
_OF_PRIMITIVE = ("symmetry", "goal_encoding", "clock_frequency", "intervals", "fall_price", "hide_position")
"""Settings, beside `primitive_...`, that come with a transferred primitive or have no effect on a frozen one."""
_STEPS_PER_S = 16_000  # of one core: 10,000 for the ant, 35,000 for the point


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """The size of the experiments."""

    preset: str
    seeds: Mapping[str, int]
    """Number of seeds by body."""
    settings: Mapping[str, Any]
    episodes: int
    env_steps: Mapping[str, int] = field(default_factory=dict)
    """Environment steps of training, by environment; without, the preset's generations."""
    branched_population: int | None = None
    """Size of a population of branched pairs beside controllers, if it is not the form's."""
    hiro: Mapping[str, Any] = field(default_factory=dict)
    """Settings of HIRO over `hiro_preset`. Its steps take much longer, because each comes with updates."""
    hiro_preset: str = "laptop"

    def form(self, body: str, task: str, form: str) -> dict[str, Any]:
        """Return the settings of a form over the preset: of two levels, or of a primitive alone for Flagrun."""
        settings = dict((_ALONE if task == "flagrun" else _FORMS)[body, form])
        if self.preset == "paper" and form == PUBLISHED:
            settings = {}
        elif self.preset != "laptop" and (body, form) == ("ant", PIECES):
            laptop = make_config(f"ant-{task}", "laptop").settings
            settings = {name: laptop[name] for name in _PIECES if name in laptop}
        if self.branched_population is not None and "primitive_population_size" in settings:
            settings["primitive_population_size"] = self.branched_population
        return settings


SCALES: dict[str, _Scale] = {
    # Table I: 3000 generations, at most ten hours, ten runs.
    "paper": _Scale(
        preset="paper",
        seeds={"ant": 10},
        settings={"minutes": 600.0},
        episodes=200,
        hiro={"minutes": 600.0},
        hiro_preset="hiro-table1",
    ),
    "laptop": _Scale(
        preset="laptop",
        seeds={"point": 10, "ant": 5},
        settings={"horizon": 500, "evaluation_horizon": 500, "evaluation_episodes": 20, "evaluation_interval": 5},
        episodes=100,
        env_steps={
            **{f"point-{task}": 1_500_000 for task in TASKS},
            "point-flagrun": 500_000,
            "ant-gather": 6_000_000,
            "ant-maze": 2_000_000,
            "ant-push": 2_000_000,
            "ant-flagrun": 1_000_000,
        },
        hiro={
            "horizon": 500,
            "evaluation_horizon": 500,
            "evaluation_episodes": 20,
            "evaluation_interval": 4,
            "env_steps": 300_000,
            "generations": 100_000,
        },
    ),
    # A test, too short to learn.
    "smoke": _Scale(
        preset="smoke",
        seeds={"point": 2, "ant": 1},
        settings={
            "population_size": 8,
            "horizon": 50,
            "evaluation_horizon": 50,
            "evaluation_episodes": 2,
            "evaluation_interval": 2,
            "noise_table_size": 1_000_000,
        },
        episodes=4,
        env_steps={f"{body}-{task}": 1_000 for body in ("point", "ant") for task in (*TASKS, "flagrun")},
        branched_population=8,
        hiro={
            "horizon": 50,
            "evaluation_horizon": 50,
            "evaluation_episodes": 2,
            "warmup_steps": 200,
            "generation_steps": 100,
            "env_steps": 400,
            "generations": 100_000,
        },
        hiro_preset="smoke",
    ),
}


def figure_3(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of figure 3: the test score of SHES, and of HIRO, with `seeds` seeds.

    Raises:
        UnknownNameError: There is no such scale: `paper` needs a cluster, `laptop` hours of two cores, `smoke` minutes.
        ConfigError: `seeds` is not positive.
    """
    return _study("fig3", scale, seeds, {METHODS: (PUBLISHED, PIECES, HIRO)})


def figure_5(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the runs of figure 5: the training reward of SHES and SHES-TL; otherwise as `figure_3`."""
    return _study("fig5", scale, seeds, dict.fromkeys((METHODS, TRANSFER), (PUBLISHED, PIECES)))


@checked
def _study(
    figure: str,
    scale: Annotated[str, Choices(SCALES)],
    seeds: Annotated[int, Ge(1)] | None,
    groups: Mapping[str, tuple[str, ...]],
) -> Study:
    """Return the runs of a figure with these forms of each group."""
    size = SCALES[scale]
    cells = tuple(
        cell
        for body, own in size.seeds.items()
        for seed in range(1, 1 + (seeds or own))
        for group, forms in groups.items()
        for form in forms
        for cell in _cells(size, body, group, form, seed)
    )
    return Study(
        cells=cells,
        episodes=size.episodes,
        design=_design(figure, size, groups),
        has_large_runs=size.preset == "paper",
    )


def _cells(size: _Scale, body: str, group: str, form: str, seed: int) -> Iterator[Cell]:
    """Yield the runs of a method on the tasks of a body; with transfer, the primitive's run first."""

    def cell(task: str, settings: Mapping[str, Any], primitive: str | None = None) -> Cell:
        env, preset = f"{body}-{task}", size.preset
        if form == HIRO:
            settings, preset = {"algorithm": "hiro", **size.hiro}, size.hiro_preset
        else:
            steps = size.env_steps.get(env)
            budget = {} if steps is None else {"env_steps": steps, "generations": 100_000}
            settings = {**settings, **size.settings, **budget}
            if (preset, body, form) == ("laptop", "ant", PUBLISHED):
                preset = "smoke"
        return Cell(
            group=group, variant=form, env=env, seed=seed, settings=settings, primitive=primitive, preset=preset
        )

    if form == HIRO:
        yield from (cell(task, {}) for task in TASKS)
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
            if name not in _OF_PRIMITIVE and not name.startswith("primitive_")
        }
        yield cell(task, own, walker.name)


def _design(figure: str, size: _Scale, groups: Mapping[str, tuple[str, ...]]) -> StudyDesign:
    """Return comparisons and figures: a panel per task, over environment steps and over hours."""
    envs = [f"{body}-{task}" for body in size.seeds for task in TASKS]
    measure = _SCORE if figure == "fig3" else _TRAINING
    curves = tuple(
        Curve(group, form, _LABELS[group, form], is_after_primitive=group == TRANSFER)
        for group, forms in groups.items()
        for form in forms
    )

    def panels(x: Literal["env_steps", "hours"]) -> tuple[CurvePanel, ...]:
        return tuple(
            CurvePanel(
                env,
                env.replace("-", " ").title(),
                curves,
                measure=measure,
                x=x,
                references=REFERENCES.get(env, ()) if figure == "fig3" else (),
                has_running_best=figure == "fig3",
            )
            for env in envs
        )

    return StudyDesign(
        groups={group: _GROUPS[group] for group in groups},
        base=(METHODS, PUBLISHED),
        metrics={env: Measure("best_score", "score of the best checkpoint", "score") for env in envs},
        curves=dict.fromkeys(envs, measure),
        labels={form: _WORDS[form] for forms in groups.values() for form in forms},
        paired={group: ((PUBLISHED, PIECES),) for group in groups if group == TRANSFER},
        figures=tuple(
            Curves(
                file=f"{figure}-{x.replace('_', '-')}.png", groups=tuple(groups), panels=panels(x), columns=len(TASKS)
            )
            for x in ("env_steps", "hours")
        ),
        formats=("svg", "png"),
        steps_per_s=_STEPS_PER_S,
    )
