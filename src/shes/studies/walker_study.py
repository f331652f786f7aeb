"""The learning study: an ablation of the walker's training method, on Ant Flagrun.

Source: docs/learning.md. Every run ends with the generation that reaches the same number of environment steps; all
variants are compared with one base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, Any

from shes.checked import checked
from shes.settings import Choices
from shes.studies.design import (
    Curve,
    CurvePanel,
    Curves,
    Forest,
    Measure,
    StudyDesign,
    Sweep,
    Variant,
    multiplied,
    sweep_name,
    whole,
    within,
)
from shes.studies.study import Seeds, Study, generation_steps
from shes.studies.study_tables import Cell
from shes.training.make_config import make_config

ENV = "ant-flagrun"
GROUPS: dict[str, str] = {
    "pieces": "the base with one piece left out or changed",
    "form": "the paper's form, alone and with one piece added",
    "alternatives": "other networks, rewards and schedule",
    "sweep": "population, sigma, learning rate and intervals, at half and twice the base",
    "grid": "two of population, sigma and learning rate, each at half or twice the base",
}
BASE = "base"
SWEPT = ("population_size", "sigma", "learning_rate", "intervals")
FACTORS = (0.5, 2.0)

_PRESET = "smoke"
"""Not `laptop`, which would bring back pieces that a variant leaves out."""
_BASE: dict[str, Any] = {
    "primitive_view": "egocentric",
    "symmetry": "dihedral",
    "primitive_estimate": "interval",
    "intervals": 2,
    "fall_price": 2.0,
    "population_size": 1200,
    "sigma": 0.05,
    "learning_rate": 0.02,
    "weight_decay": 0.0,
    "hidden": (),
    "output_weights": "zero",
    "clock_frequency": 0.8,
    "goal_encoding": "angle_metres",
    "horizon": 500,
    "evaluation_horizon": 500,
    "primitive_reward": "progress",
    "generations": 10_000,  # the steps end the run
    "keep_checkpoints": 10_000,
    "noise_table_size": 5_000_000,
}
"""The best of some thirty runs of a minute on two cores, with one or two seeds."""


@dataclass(frozen=True, kw_only=True)
class _LearningScale:
    """The size of the study."""

    settings: Mapping[str, Any]
    seeds: int
    env_steps: int
    evaluation_steps: int
    """Environment steps of training between evaluations."""
    episode_population: int
    """Population if the fitness is that of whole episodes."""
    episodes: int


SCALES: dict[str, _LearningScale] = {
    "laptop": _LearningScale(
        settings={"evaluation_episodes": 20},
        seeds=5,
        env_steps=660_000,
        evaluation_steps=60_000,
        episode_population=240,
        episodes=50,
    ),
    # A test, too short to learn.
    "smoke": _LearningScale(
        settings={
            "population_size": 8,
            "horizon": 50,
            "evaluation_horizon": 50,
            "evaluation_episodes": 2,
            "noise_table_size": 100_000,
        },
        seeds=2,
        env_steps=2_000,
        evaluation_steps=800,
        episode_population=8,
        episodes=4,
    ),
}


_EPISODES = {
    "primitive_estimate": "episode",
    "intervals": None,
    "episodes_per_policy": 1,
    "fitness_shaping": "centred_rank",
}
_NO_VIEW = {"primitive_view": "proprioception", "symmetry": None}
_FORM = {
    **_NO_VIEW,
    **_EPISODES,
    "output_weights": "glorot_normal",
    "clock_frequency": None,
    "goal_encoding": "angle",
    "fall_price": 0.0,
}
"""The paper's form. A setting that is None is left to the package's default, and unset where it has no meaning."""
_EGOCENTRIC = {"primitive_view": "egocentric", "symmetry": "none"}


def variants(scale: str = "laptop") -> dict[str, dict[str, Variant]]:
    """Return the variants of every group, the base first."""
    size = SCALES[scale]
    base = {**_BASE, **size.settings}
    whole_episodes = {**_EPISODES, "population_size": size.episode_population}
    form = {**_FORM, **whole_episodes}
    branched = {name: base.get(name) for name in whole_episodes}
    generations = math.ceil(size.env_steps / generation_steps(make_config(ENV, _PRESET, base)))
    decay = {"sigma_end": base["sigma"] / 5, "schedule_generations": generations}
    return {
        "pieces": _pieces(whole_episodes),
        "form": {
            "form": Variant("paper's form", form),
            "form-egocentric": Variant("form + egocentric", {**form, **_EGOCENTRIC}),
            "form-dihedral": Variant("form + egocentric, dihedral", {**form, **_EGOCENTRIC, "symmetry": "dihedral"}),
            "form-interval": Variant("form + branched pairs", {**form, **branched}),
            "form-zero": Variant("form + zero output", {**form, "output_weights": "zero"}),
            "form-clock": Variant("form + clock", {**form, "clock_frequency": base["clock_frequency"]}),
            "form-goal": Variant("form + metres in the goal", {**form, "goal_encoding": base["goal_encoding"]}),
            "form-fall-price": Variant("form + fall price", {**form, "fall_price": base["fall_price"]}),
        },
        "alternatives": {
            "hidden-32": Variant("32 hidden units", {"hidden": (32,)}),
            "hidden-64-64": Variant("64 × 64 hidden units", {"hidden": (64, 64)}),
            "metres": Variant("paid in metres", {"primitive_reward": "metres"}),
            "negative-distance": Variant("paid minus the distance", {"primitive_reward": "negative_distance"}),
            "cosine": Variant("paid for the direction", {"primitive_reward": "cosine"}),
            "sigma-decay": Variant("sigma to a fifth", decay),
        },
        "sweep": {
            sweep_name(name, factor): Variant(f"{_words(name)} × {factor:g}", multiplied(base, name, factor))
            for name in SWEPT
            for factor in FACTORS
        },
        "grid": _grid(base),
    }


def _grid(base: Mapping[str, Any]) -> dict[str, Variant]:
    """Return the corners: two settings, each at half or twice the base."""
    return {
        f"{sweep_name(one, by)}-{sweep_name(other, at)}": Variant(
            f"{_words(one)} × {by:g}, {_words(other)} × {at:g}", multiplied(base, one, by) | multiplied(base, other, at)
        )
        for one, other in combinations(("population_size", "sigma", "learning_rate"), 2)
        for by in FACTORS
        for at in FACTORS
    }


def _words(setting: str) -> str:
    return setting.replace("_", " ")


def _pieces(whole_episodes: Mapping[str, Any]) -> dict[str, Variant]:
    """Return the base, and variants that lack one piece of it or change it."""
    return {
        BASE: Variant("base", {}),
        "no-view": Variant("world's frame", _NO_VIEW),
        "no-symmetry": Variant("no symmetry", {"symmetry": "none"}),
        "rotation": Variant("rotation alone", {"symmetry": "rotation"}),
        "glorot-output": Variant("random output layer", {"output_weights": "glorot_normal"}),
        "no-clock": Variant("no clock", {"clock_frequency": None}),
        "episodes": Variant("whole episodes", whole_episodes),
        # Only whole episodes can do without mirroring: branches are pairs.
        "episodes-unmirrored": Variant("whole episodes, no mirroring", {**whole_episodes, "mirrored": "none"}),
        "goal-angle": Variant("goal as angle", {"goal_encoding": "angle"}),
        "fall-price-0": Variant("falls cost nothing", {"fall_price": 0.0}),
        "fall-price-8": Variant("falls cost 8", {"fall_price": 8.0}),
    }


@checked
def learning(scale: Annotated[str, Choices(SCALES)] = "laptop", seeds: Seeds | None = None) -> Study:
    """Return the cells of the learning study, with `seeds` seeds of every variant; with those of the scale if None.

    Raises:
        UnknownNameError: There is no such scale: `laptop` takes three hours on two cores, `smoke` a minute.
        ConfigError: `seeds` is not from 1 to 1000.
    """
    size, groups = SCALES[scale], variants(scale)
    cells = tuple(
        Cell(group=group, variant=name, env=ENV, seed=seed, settings=_settings(variant, size), preset=_PRESET)
        for group, found in groups.items()
        for name, variant in found.items()
        for seed in range(1, 1 + (seeds or size.seeds))
    )
    labels = {name: variant.words for found in groups.values() for name, variant in found.items()}
    return Study(cells=cells, episodes=size.episodes, design=_design(labels))


def _settings(variant: Variant, size: _LearningScale) -> dict[str, Any]:
    """Return the settings of a variant, with the same environment steps and evaluations for all variants."""
    merged = {**_BASE, **size.settings, **variant.changes, "env_steps": size.env_steps}
    settings = {name: value for name, value in merged.items() if value is not None}
    steps = generation_steps(make_config(ENV, _PRESET, settings))
    return {**settings, "evaluation_interval": whole(size.evaluation_steps / steps)}


def _design(labels: Mapping[str, str]) -> StudyDesign:
    base = Curve("pieces", BASE)

    def panel(title: str, group: str, *names: str) -> CurvePanel:
        return CurvePanel(ENV, title, (base, *(Curve(group, name) for name in names)))

    pieces = ("no-view", "no-symmetry", "rotation", "no-clock", "episodes")
    form = ("form", "form-egocentric", "form-dihedral", "form-interval", "form-zero")
    pieces_of_form = (*form[1:], "form-clock", "form-goal", "form-fall-price")
    others = ("hidden-32", "hidden-64-64", "z-score", "metres", "sigma-decay")
    return StudyDesign(
        groups=GROUPS,
        base=("pieces", BASE),
        metrics={ENV: Measure("last_return", "return of the last policy over 500 steps", "return")},
        curves={ENV: Measure("return_mean", "evaluation return")},
        labels=labels,
        paired=(
            *within("pieces", ("episodes", "episodes-unmirrored")),
            *within("form", *(("form", name) for name in pieces_of_form)),
        ),
        figures=(
            Forest(file="pieces.png", group="pieces"),
            Forest(file="form.png", group="form"),
            Forest(file="alternatives.png", group="alternatives"),
            Forest(file="grid.png", group="grid"),
            Sweep(file="sweep.png", group="sweep", settings=SWEPT, factors=FACTORS),
            Curves(
                file="curves.png",
                groups=tuple(GROUPS),
                panels=(
                    panel("A piece left out", "pieces", *pieces),
                    panel("Added to the form", "form", *form),
                    panel("Alternatives", "alternatives", *others),
                ),
            ),
        ),
    )
