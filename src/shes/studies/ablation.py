"""The ablation: which choices of the paper hold up on Point Gather and Point Maze, and how sensitive the settings are.

Source: SHES paper II-B to II-F (the choices), III-C (robustness to hyper-parameters, which it claims), II-D (transfer)
and its Ant Maze at horizon 500 and 1000. Everything is compared with one base per task.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shes.studies.design import (
    Curve,
    CurvePanel,
    Curves,
    Forest,
    Measure,
    StudyDesign,
    Sweep,
    check_size,
    multiplied,
    sweep_name,
    whole,
)
from shes.studies.study import Study
from shes.studies.tables import Cell
from shes.training.presets import make_config

__all__ = ["BASE", "ENVS", "FACTORS", "GROUPS", "SCALES", "SWEPT", "ablation"]

ENVS = ("point-gather", "point-maze")
GROUPS: dict[str, str] = {
    "choices": "what the paper chose: mirroring, perturbation, primitive reward, goal encoding",
    "sweep": "sigma, learning rate, interval, goal distance, population, at a quarter to four times the base",
    "transfer": "a primitive that was trained alone: frozen, and learning on",
    "horizon": "the maze with longer episodes, and as many environment steps",
}
"""Groups of cells, and what they ask."""
BASE = "base"
_METRICS = {
    "point-gather": Measure("best_score", "score of the best checkpoint", "score"),
    "point-maze": Measure(
        "last_training_success", "share of random free targets that the last policies reach", "targets reached"
    ),
}
"""What is compared on each task, on fresh episodes.

The maze's own score, one target behind two corners, is 0 with all that two million steps can do: it would tell nothing.
"""
_CURVES = {
    "point-gather": Measure("score_mean", "evaluation score"),
    "point-maze": Measure("training_success_rate", "share of training's targets reached"),
}
_STEPS_PER_S = 30_000
"""Of one core, all of a run included; measured: 32,000 to 45,000 on an AMD EPYC."""

_PRIMITIVE_ENV = "point-flagrun"
_SHARED: dict[str, Any] = {
    "controller_interval": 10,
    "population_size": 160,
    "sigma": 0.1,
    "weight_decay": 0.0,
    "hidden": (32,),
    "evaluation_interval": 10,
    "evaluation_episodes": 20,
    "noise_table_size": 5_000_000,
}
_GATHER: dict[str, Any] = {**_SHARED, "horizon": 100, "learning_rate": 0.03, "generations": 80}
_BASES: dict[str, dict[str, Any]] = {
    "point-gather": _GATHER,
    "point-maze": {
        **_SHARED,
        "horizon": 150,
        "evaluation_horizon": 200,
        "learning_rate": 0.05,
        "generations": 60,
        "target_sampling": "free_cells",  # a curriculum: a fixed target leaves all in the dead end
        "evaluation_target": (16.0, 16.0),  # the first corner: the only fixed target ever reached in this time
    },
    _PRIMITIVE_ENV: _GATHER,
}
"""The base of each task, over the preset laptop; of Flagrun, to train a primitive alone with the same budget.

Found by 33 short runs, most of one seed: what learns on most seeds within 1.5 million steps.
"""

SWEPT = ("sigma", "learning_rate", "controller_interval", "goal_distance", "population_size")
FACTORS = (0.25, 0.5, 2.0, 4.0)
"""What the base's values are multiplied by; the base itself is the 1."""
_CHOICES: dict[str, tuple[str, dict[str, Any]]] = {
    "mirrored-pair": ("two-way mirroring", {"mirrored": "pair"}),
    "mirrored-none": ("no mirroring", {"mirrored": "none"}),
    "one-to-many": ("one to many, in turns", {"perturbation": "one_to_many"}),
    "one-to-many-halves": ("one to many, half each", {"perturbation": "one_to_many_halves"}),
    "reward-negative-distance": ("reward: negative distance", {"primitive_reward": "negative_distance"}),
    "reward-cosine": ("reward: cosine", {"primitive_reward": "cosine"}),
    "goal-unit-vector": ("goal: unit vector", {"goal_encoding": "unit_vector"}),
    "goal-vector": ("goal: plain vector", {"goal_encoding": "vector"}),
    "goal-angle-metres": ("goal: distance in metres", {"goal_encoding": "angle_metres"}),
}
"""Variants of the choices, with their words and what they change."""
_SCRATCH = "scratch"
_TRANSFERS: dict[str, tuple[str, dict[str, Any]]] = {
    # A transferred primitive sees less than the base's: what is compared with it must, too.
    _SCRATCH: ("no transfer, same view", {"primitive_view": "proprioception"}),
    "frozen": ("transfer, frozen", {"freeze_primitive": True}),
    "unfrozen": ("transfer, learning on", {"freeze_primitive": False}),
}


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """How large the ablation is."""

    settings: Mapping[str, Any]
    """Settings over every base."""
    seeds: int
    sweep_seeds: int
    horizons: tuple[int, ...]
    """Longer episodes of the maze."""
    episodes: int
    """Fresh episodes at the end of every run."""


SCALES: dict[str, _Scale] = {
    "laptop": _Scale(settings={}, seeds=10, sweep_seeds=5, horizons=(500, 1000), episodes=100),
    # To see that everything works, not to learn.
    "smoke": _Scale(
        settings={
            "population_size": 8,
            "generations": 4,
            "horizon": 20,
            "evaluation_horizon": 20,
            "hidden": (4,),
            "evaluation_interval": 2,
            "evaluation_episodes": 2,
            "noise_table_size": 100_000,
        },
        seeds=2,
        sweep_seeds=2,
        horizons=(40, 80),
        episodes=4,
    ),
}


def ablation(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the cells of the ablation.

    Args:
        scale: `laptop`, hours on two cores; or `smoke`, a minute.
        seeds: Seeds of every variant; the scale's own number if none.

    Raises:
        UnknownNameError: There is no such scale.
        ConfigError: `seeds` is not positive.
    """
    check_size(scale, seeds, SCALES)
    size = SCALES[scale]
    bases = {env: _base(env, size) for env in _BASES}
    cells: list[Cell] = []

    def add(group: str, variant: str, env: str, settings: Mapping[str, Any], count: int, **more: Any) -> None:
        for seed in range(1, 1 + (seeds or count)):
            primitive = f"{_PRIMITIVE_ENV}/transfer/{BASE}/seed-{seed}" if more.get("is_transferred") else None
            cells.append(
                Cell(
                    group=group,
                    variant=variant,
                    env=env,
                    seed=seed,
                    settings={**bases[env], **settings},
                    primitive=primitive,
                )
            )

    add("transfer", BASE, _PRIMITIVE_ENV, {}, size.seeds)
    for env in ENVS:
        add("choices", BASE, env, {}, size.seeds)
        for name, (_, settings) in _CHOICES.items():
            add("choices", name, env, settings, size.seeds)
        for name in SWEPT:
            for factor in FACTORS:
                add("sweep", sweep_name(name, factor), env, _swept(bases[env], name, factor), size.sweep_seeds)
        for name, (_, settings) in _TRANSFERS.items():
            add("transfer", name, env, settings, size.seeds, is_transferred=name != _SCRATCH)
    for steps in size.horizons:
        longer = {"horizon": steps, "evaluation_horizon": steps}
        settings = {**longer, **_equal_steps(bases["point-maze"], longer)}
        add("horizon", f"horizon-{steps}", "point-maze", settings, size.seeds)
    return Study(cells=tuple(cells), episodes=size.episodes, design=_design(bases["point-maze"]["horizon"], size))


def _design(horizon: int, size: _Scale) -> StudyDesign:
    """Return what is compared and drawn; the episodes of the maze have `horizon` steps, but for the longer ones."""
    transfers = tuple(Curve("transfer", variant) for variant in _TRANSFERS)
    longer = (Curve("horizon", f"horizon-{steps}", f"{steps} steps") for steps in size.horizons)
    horizons = (Curve("choices", BASE, f"{horizon} steps"), *longer)
    return StudyDesign(
        groups=GROUPS,
        base=("choices", BASE),
        metrics=_METRICS,
        curves=_CURVES,
        labels={name: words for name, (words, _) in (_CHOICES | _TRANSFERS).items()},
        paired={
            "transfer": ((_SCRATCH, "frozen"), (_SCRATCH, "unfrozen"), ("frozen", "unfrozen")),
            "horizon": ((f"horizon-{size.horizons[0]}", f"horizon-{size.horizons[-1]}"),),
        },
        figures=(
            Forest(file="choices.png", group="choices"),
            Sweep(file="sweep.png", group="sweep", settings=SWEPT, factors=FACTORS),
            Curves(
                file="transfer.png",
                groups=("transfer", "horizon"),
                panels=(
                    CurvePanel("point-gather", "Point Gather", transfers),
                    CurvePanel("point-maze", "Point Maze", transfers),
                    CurvePanel("point-maze", "Point Maze, horizon", horizons),
                ),
            ),
        ),
        steps_per_s=_STEPS_PER_S,
    )


def _base(env: str, size: _Scale) -> dict[str, Any]:
    """Return the settings of a base, those that are swept or scaled among them even where they are the preset's."""
    settings = {**_BASES[env], **size.settings}
    there = make_config(env, "laptop", settings).settings
    return {**{name: there[name] for name in SWEPT}, **settings}


def _swept(base: Mapping[str, Any], name: str, factor: float) -> dict[str, Any]:
    """Return what changes where setting `name` is `factor` times the base's: a population has as many steps in all."""
    settings = multiplied(base, name, factor)
    return {**settings, **_equal_steps(base, settings)} if name == "population_size" else settings


def _equal_steps(base: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return generations and the interval of evaluations with which `changed` has the environment steps of `base`."""
    ratio = math.prod(base[name] / changed.get(name, base[name]) for name in ("population_size", "horizon"))
    return {name: whole(base[name] * ratio) for name in ("generations", "evaluation_interval")}
