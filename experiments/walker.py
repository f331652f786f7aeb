"""The walker study: what each piece of the walker's training method is worth, on Ant Flagrun.

Source: docs/learning.md. Every run ends with the generation that reaches the same number of environment steps; all
variants are compared with one base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

from experiments.design import (
    SMOKE,
    Experiment,
    Measure,
    Run,
    Variant,
    find_size,
    generation_steps,
    multiplied,
    sweep_name,
    whole,
    within,
)
from experiments.figures import forest
from shes.runs.make_config import make_config

ENV = "ant-flagrun"
GROUPS: dict[str, str] = {
    "pieces": "the base with one piece left out or changed",
    "form": "the paper's form, alone and with one piece added",
    "alternatives": "other networks, rewards and schedule",
    "sweep": "population, sigma, learning rate and intervals, at half and twice the base",
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


class _Size(NamedTuple):
    """The size of the study."""

    settings: Mapping[str, Any]
    seeds: int
    env_steps: int
    evaluation_steps: int
    """Environment steps of training between evaluations."""
    episode_population: int
    """Population if the fitness is that of whole episodes."""
    episodes: int


SCALES = {
    "laptop": _Size(
        {"evaluation_episodes": 20}, 5, env_steps=660_000, evaluation_steps=60_000, episode_population=240, episodes=50
    ),
    "smoke": _Size(SMOKE, 2, env_steps=2_000, evaluation_steps=800, episode_population=8, episodes=4),
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
    config = make_config(ENV, _PRESET, base)
    generations = math.ceil(size.env_steps / generation_steps(config))
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
            sweep_name(name, factor): Variant(f"{name.replace('_', ' ')} × {factor:g}", multiplied(base, name, factor))
            for name in SWEPT
            for factor in FACTORS
        },
    }


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


def walker(scale: str = "laptop", seeds: int | None = None) -> Experiment:
    """Return the runs of the walker study, with `seeds` seeds of every variant; with those of the scale if None."""
    size, groups = find_size(scale, SCALES, seeds), variants(scale)
    return Experiment(
        runs=tuple(
            Run(group=group, variant=name, env=ENV, seed=seed, settings=_settings(variant, size), preset=_PRESET)
            for group, found in groups.items()
            for name, variant in found.items()
            for seed in range(1, 1 + (seeds or size.seeds))
        ),
        groups=GROUPS,
        base=("pieces", BASE),
        metrics={ENV: Measure("last_return", "return of the last policy over 500 steps")},
        labels={name: variant.words for found in groups.values() for name, variant in found.items()},
        pairs=(
            *within("pieces", ("episodes", "episodes-unmirrored")),
            *within("form", *(("form", name) for name in groups["form"] if name != "form")),
        ),
        figures={f"{group}.png": partial(forest, group=group) for group in GROUPS},
        episodes=size.episodes,
    )


def _settings(variant: Variant, size: _Size) -> dict[str, Any]:
    """Return the settings of a variant, with the same environment steps and evaluations for all variants."""
    merged = {**_BASE, **size.settings, **variant.changes, "env_steps": size.env_steps}
    settings = {name: value for name, value in merged.items() if value is not None}
    config = make_config(ENV, _PRESET, settings)
    steps = generation_steps(config)
    return {**settings, "evaluation_interval": whole(size.evaluation_steps / steps)}
