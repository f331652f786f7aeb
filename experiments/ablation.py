"""The ablation: the choices of the paper, and the sensitivity to settings, on Point Gather and Point Maze.

Source: SHES paper II-B to II-F (the choices), III-C (robustness to hyper-parameters, which it claims) and II-D
(transfer). All variants are compared with one base per task: on Gather the published form, on Maze the preset with
centred ranks, from which changes to the published form are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

from experiments.design import (
    SMOKE,
    Experiment,
    Measure,
    Run,
    Variant,
    find_size,
    multiplied,
    sweep_name,
    whole,
    within,
)
from experiments.figures import forest
from shes.runs.make_config import make_config

ENVS = ("point-gather", "point-maze")
GROUPS: dict[str, str] = {
    "choices": "the paper's choices: mirroring, perturbation, primitive reward, goal encoding",
    "without": "the preset with centred ranks, without some of its changes to the published form",
    "sweep": "sigma, learning rate, interval, goal distance, population, at a quarter to four times the base",
    "transfer": "a primitive that was trained alone: frozen, and learning further",
}
BASE = "base"
_METRICS = {
    "point-gather": Measure("best_score", "score of the best checkpoint"),
    "point-maze": Measure("last_success", "share of episodes in which the last policies reach the target"),
}
"""The measure compared on each task, on fresh episodes."""
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
        "fitness_shaping": "centred_rank",  # which suits all variants
        "env_steps": 1_500_000,
        "generations": 1000,
        "evaluation_interval": 10,
        "evaluation_episodes": 20,
    },
    _PRIMITIVE_ENV: _GATHER,
}
"""The base of each task, over the preset laptop; that of Flagrun trains a primitive alone with the same budget.

That of Gather was found by 33 short runs, most with one seed.
"""
_FIRST_SEEDS = {"point-maze": 11}
"""The first seed of a task, if not 1: the preset was chosen with seeds 1 to 5."""

SWEPT = ("sigma", "learning_rate", "controller_interval", "goal_distance", "population_size")
FACTORS = (0.25, 0.5, 2.0, 4.0)
_CHOICES: dict[str, Variant] = {
    "mirrored-pair": Variant("two-way mirroring", {"mirrored": "pair"}),
    "mirrored-none": Variant("no mirroring", {"mirrored": "none"}),
    "one-to-many": Variant("one to many, in turns", {"perturbation": "one_to_many"}),
    "one-to-many-halves": Variant("one to many, half each", {"perturbation": "one_to_many_halves"}),
    "reward-negative-distance": Variant("reward: negative distance", {"primitive_reward": "negative_distance"}),
    "reward-cosine": Variant("reward: cosine", {"primitive_reward": "cosine"}),
    "goal-unit-vector": Variant("goal: unit vector", {"goal_encoding": "unit_vector"}),
    "goal-vector": Variant("goal: plain vector", {"goal_encoding": "vector"}),
    "goal-angle-metres": Variant("goal: distance in metres", {"goal_encoding": "angle_metres"}),
}
_LEFT_OUT: dict[str, Variant] = {
    "no-search": Variant("no search for a path", {"explore": "none"}),
    "no-branches": Variant("primitive by whole episodes", {"primitive_estimate": "episode"}),
    "no-egocentric-view": Variant("no egocentric view", {"primitive_view": "proprioception", "symmetry": "none"}),
    "no-position-view": Variant("controller sees everything", {"controller_view": "observation"}),
    "pair-ranks": Variant("controllers ranked in pairs: the preset", {"fitness_shaping": "pair_rank"}),
}
_TRANSFERS: dict[str, Variant] = {
    # A transferred primitive observes less than that of the base: so does its baseline.
    "scratch": Variant("no transfer, same view", {"primitive_view": "proprioception"}),
    "frozen": Variant("transfer, frozen", {"freeze_primitive": True}),
    "unfrozen": Variant("transfer, learning on", {"freeze_primitive": False}),
}


class _Size(NamedTuple):
    """The size of the ablation."""

    settings: Mapping[str, Any]
    seeds: int
    sweep_seeds: int
    episodes: int


SCALES = {
    "laptop": _Size({}, seeds=10, sweep_seeds=5, episodes=100),
    "smoke": _Size({**SMOKE, "generations": 4, "hidden": (4,)}, seeds=2, sweep_seeds=2, episodes=4),
}


def ablation(scale: str = "laptop", seeds: int | None = None) -> Experiment:
    """Return the runs of the ablation, with `seeds` seeds of every variant; with those of the scale if None."""
    size = find_size(scale, SCALES, seeds)
    bases = {env: _base(env, size) for env in _BASES}
    primitives = [
        Run(group="transfer", variant=BASE, env=_PRIMITIVE_ENV, seed=seed, settings=bases[_PRIMITIVE_ENV])
        for seed in _seeds(_PRIMITIVE_ENV, seeds or size.seeds)
    ]
    runs = [
        Run(
            group=group,
            variant=name,
            env=env,
            seed=seed,
            settings={**bases[env], **settings},
            primitive=primitives[seed - 1] if "freeze_primitive" in settings else None,
        )
        for env, group, name, settings in _variants(bases)
        for seed in _seeds(env, seeds or (size.sweep_seeds if group == "sweep" else size.seeds))
    ]
    return Experiment(
        runs=(*primitives, *runs),
        groups=GROUPS,
        base=("choices", BASE),
        metrics=_METRICS,
        labels={name: variant.words for name, variant in (_CHOICES | _LEFT_OUT | _TRANSFERS).items()},
        pairs=within("transfer", ("scratch", "frozen"), ("scratch", "unfrozen"), ("frozen", "unfrozen")),
        figures={f"{group}.png": partial(forest, group=group) for group in GROUPS},
        episodes=size.episodes,
    )


def _seeds(env: str, count: int) -> range:
    first = _FIRST_SEEDS.get(env, 1)
    return range(first, first + count)


def _variants(bases: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str, str, Mapping[str, Any]]]:
    """Yield environment, group, name and changed settings of every variant."""
    gather, maze = ENVS
    for env in ENVS:
        yield env, "choices", BASE, {}
    for name, variant in _CHOICES.items():
        yield gather, "choices", name, variant.changes
    for name in SWEPT:
        for factor in FACTORS:
            changes = multiplied(bases[gather], name, factor)
            if name == "population_size":
                changes |= _equal_steps(bases[gather], changes)
            yield gather, "sweep", sweep_name(name, factor), changes
    for name, variant in _TRANSFERS.items():
        yield gather, "transfer", name, variant.changes
    for name, variant in _LEFT_OUT.items():
        yield maze, "without", name, variant.changes


def _base(env: str, size: _Size) -> dict[str, Any]:
    """Return the settings of a base, with those that are swept or scaled even if they are the preset's."""
    settings = {**_BASES[env], **size.settings}
    there = make_config(env, "laptop", settings).values
    return {**{name: there[name] for name in SWEPT}, **settings}


def _equal_steps(base: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the generations and evaluation interval with which `changed` has the environment steps of `base`."""
    ratio = base["population_size"] / changed["population_size"]
    return {name: whole(base[name] * ratio) for name in ("generations", "evaluation_interval")}
