"""The learning study: what each piece of the walker's learning is worth, on Ant Flagrun.

Source: learning specification, sections 1 to 3. Every run ends with the generation that reaches the same number of
environment steps, whatever its population or estimate; everything is compared with one base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

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
from shes.studies.study import Study, generation_steps
from shes.studies.tables import Cell
from shes.training.presets import make_config

__all__ = ["BASE", "ENV", "FACTORS", "GROUPS", "SCALES", "SWEPT", "Variant", "learning", "variants"]

ENV = "ant-flagrun"
GROUPS: dict[str, str] = {
    "pieces": "the base, with one piece of it left out or changed",
    "form": "the paper's form, alone and with one piece added",
    "alternatives": "other networks, fitness shapings, reward and schedule",
    "sweep": "population, sigma, learning rate and intervals, at half and twice the base",
}
"""Groups of cells, and what they ask."""
BASE = "base"
SWEPT = ("population_size", "sigma", "learning_rate", "intervals")
FACTORS = (0.5, 2.0)
"""What the base's values are multiplied by; the base itself is the 1."""

_PRESET = "smoke"
"""Not `laptop`, which has most of the pieces: what a variant leaves out must be out. The base sets all else itself."""
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
"""What learned most within a minute of two cores, of some thirty short runs of one or two seeds."""


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """How large the study is."""

    settings: Mapping[str, Any]
    """Settings over the base."""
    seeds: int
    env_steps: int
    """Environment steps of training, of every run."""
    evaluation_steps: int
    """Environment steps of training between evaluations."""
    episode_population: int
    """Policies in a generation that is judged by whole episodes."""
    episodes: int
    """Fresh episodes at the end of every run."""


SCALES: dict[str, _Scale] = {
    "laptop": _Scale(
        settings={"evaluation_episodes": 20},
        seeds=5,
        env_steps=660_000,
        evaluation_steps=60_000,
        episode_population=240,
        episodes=50,
    ),
    # To see that everything works, not to learn.
    "smoke": _Scale(
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


class Variant(NamedTuple):
    """What is run beside the base."""

    words: str
    reason: str
    """Why it is run."""
    changes: Mapping[str, Any]
    """Settings over the base; one that is None is left to the package's default, and unset where it has no meaning."""


def variants(scale: str = "laptop") -> dict[str, dict[str, Variant]]:
    """Return the variants of every group, the base first of all."""
    size = SCALES[scale]
    base = {**_BASE, **size.settings}
    episodes = {
        "primitive_estimate": "episode",
        "intervals": None,
        "population_size": size.episode_population,
        "episodes_per_policy": 1,
        "fitness_shaping": "centred_rank",
    }
    intervals = {name: base.get(name) for name in episodes}
    no_view = {"primitive_view": "proprioception", "symmetry": None}
    glorot, no_clock = {"output_weights": "glorot_normal"}, {"clock_frequency": None}
    angle, free_falls = {"goal_encoding": "angle"}, {"fall_price": 0.0}
    form = {**no_view, **episodes, **glorot, **no_clock, **angle, **free_falls}
    egocentric = {"primitive_view": "egocentric", "symmetry": "none"}
    generations = math.ceil(size.env_steps / generation_steps(make_config(ENV, _PRESET, base)))
    decay = {
        "sigma_schedule": "exponential",
        "sigma_end": base["sigma"] / 5,
        "schedule_generations": generations,
    }
    return {
        "pieces": {
            BASE: Variant("base", "everything is compared with it", {}),
            "no-view": Variant("world's frame", "what seeing itself in its own frame is worth", no_view),
            "no-symmetry": Variant("no symmetry", "what the body's symmetry is worth", {"symmetry": "none"}),
            "rotation": Variant("rotation alone", "what the mirror adds to the turns", {"symmetry": "rotation"}),
            "glorot-output": Variant("random output layer", "what a start that does nothing is worth", glorot),
            "no-clock": Variant("no clock", "whether a linear policy needs a rhythm given to it", no_clock),
            "episodes": Variant("whole episodes", "what branched pairs are worth", episodes),
            "episodes-unmirrored": Variant(
                "whole episodes, no mirroring",
                "mirroring can be left out with whole episodes alone: branches are pairs",
                {**episodes, "mirrored": "none"},
            ),
            "goal-angle": Variant("goal as angle", "what the distance in metres tells beside the paper's angle", angle),
            "fall-price-0": Variant("falls cost nothing", "what a price of falls is worth", free_falls),
            "fall-price-8": Variant("falls cost 8", "whether a higher price keeps more upright", {"fall_price": 8.0}),
        },
        "form": {
            "form": Variant("paper's form", "where the paper's method stands after as many steps", form),
            "form-egocentric": Variant("form + egocentric", "the view alone", {**form, **egocentric}),
            "form-dihedral": Variant(
                "form + egocentric, dihedral",
                "the symmetry, which needs the view",
                {**form, **egocentric, "symmetry": "dihedral"},
            ),
            "form-interval": Variant("form + branched pairs", "the estimate alone", {**form, **intervals}),
            "form-zero": Variant("form + zero output", "the start alone", {**form, "output_weights": "zero"}),
        },
        "alternatives": {
            "hidden-32": Variant("32 hidden units", "whether linear is enough so early", {"hidden": (32,)}),
            "hidden-64-64": Variant("64 × 64 hidden units", "the network of the long runs", {"hidden": (64, 64)}),
            "centred-rank": Variant(
                "ranks of all", "ranks of the generation, not of pairs", {"primitive_fitness_shaping": "centred_rank"}
            ),
            "z-score": Variant(
                "z-scores", "sizes of the differences, not their order", {"primitive_fitness_shaping": "z_score"}
            ),
            "metres": Variant("paid in metres", "pay for speed, not for shares", {"primitive_reward": "metres"}),
            "sigma-decay": Variant("sigma to a fifth", "finer steps towards the end, over the whole run", decay),
        },
        "sweep": {
            sweep_name(name, factor): Variant(
                f"{name.replace('_', ' ')} × {factor:g}",
                "whether the base's value matters",
                multiplied(base, name, factor),
            )
            for name in SWEPT
            for factor in FACTORS
        },
    }


def learning(scale: str = "laptop", seeds: int | None = None) -> Study:
    """Return the cells of the learning study.

    Args:
        scale: `laptop`, two hours on two cores; or `smoke`, a minute.
        seeds: Seeds of every variant; the scale's own number if none.

    Raises:
        UnknownNameError: There is no such scale.
        ConfigError: `seeds` is not positive.
    """
    check_size(scale, seeds, SCALES)
    size, groups = SCALES[scale], variants(scale)
    cells = tuple(
        Cell(group=group, variant=name, env=ENV, seed=seed, settings=_settings(variant, size), preset=_PRESET)
        for group, found in groups.items()
        for name, variant in found.items()
        for seed in range(1, 1 + (seeds or size.seeds))
    )
    labels = {name: variant.words for found in groups.values() for name, variant in found.items()}
    return Study(cells=cells, episodes=size.episodes, design=_design(labels))


def _settings(variant: Variant, size: _Scale) -> dict[str, Any]:
    """Return the settings of the runs of `variant`: as many environment steps and evaluations as the others have."""
    merged = {**_BASE, **size.settings, **variant.changes, "env_steps": size.env_steps}
    settings = {name: value for name, value in merged.items() if value is not None}
    steps = generation_steps(make_config(ENV, _PRESET, settings))
    return {**settings, "evaluation_interval": whole(size.evaluation_steps / steps)}


def _design(labels: Mapping[str, str]) -> StudyDesign:
    """Return what is compared and drawn."""
    base = Curve("pieces", BASE)

    def panel(title: str, group: str, *names: str) -> CurvePanel:
        return CurvePanel(ENV, title, (base, *(Curve(group, name) for name in names)))

    pieces = ("no-view", "no-symmetry", "rotation", "no-clock", "episodes")
    form = ("form", "form-egocentric", "form-dihedral", "form-interval", "form-zero")
    others = ("hidden-32", "hidden-64-64", "z-score", "metres", "sigma-decay")
    return StudyDesign(
        groups=GROUPS,
        base=("pieces", BASE),
        metrics={ENV: Measure("last_return", "return of the last policy over 500 steps", "return")},
        curves={ENV: Measure("return_mean", "evaluation return")},
        labels=labels,
        paired={"pieces": (("episodes", "episodes-unmirrored"),), "form": tuple(("form", name) for name in form[1:])},
        figures=(
            Forest(file="pieces.png", group="pieces"),
            Forest(file="form.png", group="form"),
            Forest(file="alternatives.png", group="alternatives"),
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
        steps_per_s=10_000,
    )
