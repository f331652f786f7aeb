"""The ablation: which choices of the paper hold up on Point Gather and Point Maze, and how sensitive the settings are.

Source: SHES paper II-B to II-F (the choices), III-C (robustness to hyper-parameters, which it claims), II-D (transfer)
and its Ant Maze at horizon 500 and 1000. Everything is compared with one base per task.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from shes.errors import ConfigError, UnknownNameError
from shes.experiments.plot import interval
from shes.experiments.presets import make_config
from shes.experiments.records import Row
from shes.experiments.study import Study
from shes.experiments.study_tables import Cell, Summary
from shes.types import F64Array

__all__ = [
    "BASE",
    "CURVES",
    "ENVS",
    "FACTORS",
    "GROUPS",
    "LABELS",
    "METRICS",
    "SCALES",
    "STEPS_PER_S",
    "SWEPT",
    "Comparison",
    "ablation",
    "choose",
    "compare",
    "holm",
    "label",
    "permutation_test",
    "sweep_name",
]

ENVS = ("point-gather", "point-maze")
GROUPS: dict[str, str] = {
    "choices": "what the paper chose: mirroring, perturbation, primitive reward, goal encoding",
    "sweep": "sigma, learning rate, interval, goal distance, population, at a quarter to four times the base",
    "transfer": "a primitive that was trained alone: frozen, and learning on",
    "horizon": "the maze with longer episodes, and as many environment steps",
}
"""Groups of cells, and what they ask."""
BASE = "base"
METRICS = {
    "point-gather": ("best_score", "score of the best checkpoint"),
    "point-maze": ("last_training_success", "share of random free targets that the last policies reach"),
}
"""What is compared on each task, on fresh episodes: column of `runs.csv`, and its words.

The maze's own score, one target behind two corners, is 0 with all that two million steps can do: it would tell nothing.
"""
CURVES = {
    "point-gather": ("score_mean", "evaluation score"),
    "point-maze": ("training_success_rate", "share of training's targets reached"),
}
"""What learning curves show of each task: column of `curves.csv`, and its words."""
STEPS_PER_S = 30_000
"""Environment steps per second of one core, all of a run included; measured: 32,000 to 45,000 on an AMD EPYC."""

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
LABELS: dict[str, str] = {BASE: "base"} | {name: words for name, (words, _) in (_CHOICES | _TRANSFERS).items()}
"""Choices and transfers in words."""
_PAIRED = {"transfer": ((_SCRATCH, "frozen"), (_SCRATCH, "unfrozen"), ("frozen", "unfrozen"))}
"""Variants of a group that are compared with each other, too: first with second. Of `horizon`, the longest with the
shortest."""


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
    if scale not in SCALES:
        raise UnknownNameError("scale", scale, SCALES, "Set --scale.")
    if seeds is not None and seeds < 1:
        raise ConfigError(f"seeds must be a whole number of at least 1, got {seeds}. Set --seeds.")
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
    return Study(cells=tuple(cells), episodes=size.episodes)


def choose(study: Study, groups: Sequence[str]) -> Study:
    """Return the cells of `groups`, all if there is none, and the base, with which everything is compared.

    Raises:
        UnknownNameError: There is no such group.
    """
    for group in groups:
        if group not in GROUPS:
            raise UnknownNameError("group", group, GROUPS, "Set --only.")
    chosen = {cell.name for cell in study.cells if not groups or cell.group in groups or _is_base(cell)}
    return Study(cells=tuple(cell for cell in study.cells if cell.name in chosen), episodes=study.episodes)


def _is_base(cell: Cell) -> bool:
    return (cell.group, cell.variant) == ("choices", BASE)


def _base(env: str, size: _Scale) -> dict[str, Any]:
    """Return the settings of a base, those that are swept or scaled among them even where they are the preset's."""
    settings = {**_BASES[env], **size.settings}
    config = make_config(env, "laptop", settings)
    return {**{name: getattr(config, name) for name in SWEPT}, **settings}


def label(variant: str) -> str:
    """Return a variant in words."""
    return LABELS.get(variant, variant.replace("-x", " × ").replace("-", " "))


def sweep_name(setting: str, factor: float) -> str:
    """Return the variant whose `setting` is `factor` times the base's."""
    return f"{setting.replace('_', '-')}-x{factor:g}"


def _swept(base: Mapping[str, Any], name: str, factor: float) -> dict[str, Any]:
    """Return what changes where setting `name` is `factor` times the base's: a population has as many steps in all."""
    value = factor * base[name]
    if name == "population_size":
        settings = {name: 4 * _whole(value / 4)}
        return {**settings, **_equal_steps(base, settings)}
    return {name: _whole(value) if isinstance(base[name], int) else value}


def _equal_steps(base: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return generations and the interval of evaluations with which `changed` has the environment steps of `base`."""
    ratio = math.prod(base[name] / changed.get(name, base[name]) for name in ("population_size", "horizon"))
    return {name: _whole(base[name] * ratio) for name in ("generations", "evaluation_interval")}


def _whole(value: float) -> int:
    """Return the nearest whole number, at least 1; a half is rounded up."""
    return max(1, math.floor(value + 0.5))


# Comparisons.


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A variant on a task, beside another one: a row of `comparison.csv`."""

    group: str
    variant: str
    env: str
    seeds: int
    score_mean: float
    score_low: float
    """The interval of the mean over seeds, 95 %, by bootstrap."""
    score_high: float
    against: str | None = None
    """The other variant; none for the base itself."""
    difference: float | None = None
    """How much higher the mean is than the other one's."""
    p: float | None = None
    """Two-sided, by a permutation test of the difference of means."""
    p_holm: float | None = None
    """The same, corrected for the comparisons of this group on this task."""

    def row(self) -> Row:
        """Return its columns."""
        return asdict(self)


def compare(study: Study, summaries: Mapping[str, Summary]) -> list[Comparison]:
    """Return every variant of which a run is finished, compared with the base of its task; see `_PAIRED` for more."""
    scores: dict[tuple[str, str, str], list[float]] = {}
    for cell in study.cells:
        if cell.name in summaries and cell.env in ENVS:
            place = (cell.env, cell.group, cell.variant)
            scores.setdefault(place, []).append(summaries[cell.name].row[METRICS[cell.env][0]])
    found: list[Comparison] = []
    for env in ENVS:
        for group in GROUPS:
            variants = {variant: np.array(v) for (e, g, variant), v in scores.items() if (e, g) == (env, group)}
            base = scores.get((env, "choices", BASE))
            found += _compare_group(group, env, variants, None if base is None else np.array(base))
    return found


def _compare_group(group: str, env: str, variants: dict[str, F64Array], base: F64Array | None) -> list[Comparison]:
    """Return the comparisons of a group on a task, corrected for their number."""
    pairs: list[tuple[str, str | None, F64Array | None]] = []
    for variant in variants:
        is_base = (group, variant) == ("choices", BASE) or base is None
        pairs.append((variant, None, None) if is_base else (variant, BASE, base))
    extremes = ((next(iter(variants)), next(reversed(variants))),) if group == "horizon" and len(variants) > 1 else ()
    for first, second in _PAIRED.get(group, extremes):
        if first in variants and second in variants:
            pairs.append((second, first, variants[first]))
    tests = [None if other is None else permutation_test(variants[variant], other) for variant, _, other in pairs]
    corrected = iter(holm([p for p in tests if p is not None]))
    found: list[Comparison] = []
    for (variant, against, other), p in zip(pairs, tests, strict=True):
        values = variants[variant]
        low, high = interval(values[:, None])
        found.append(
            Comparison(
                group=group,
                variant=variant,
                env=env,
                seeds=len(values),
                score_mean=float(values.mean()),
                score_low=float(low[0]),
                score_high=float(high[0]),
                against=against,
                difference=None if other is None else float(values.mean() - other.mean()),
                p=p,
                p_holm=None if p is None else next(corrected),
            )
        )
    return found


def permutation_test(first: F64Array, second: F64Array, permutations: int = 10_000, seed: int = 0) -> float:
    """Return the two-sided p of the difference of means between `first` [N] and `second` [M].

    It is the share of divisions of all values into N and M whose difference is at least as large: of all of them, if
    there are no more than `permutations`, else of so many random ones, with the division at hand as one more, so that
    p is never 0 (Phipson and Smyth 2010).
    """
    pooled, count = np.concatenate([first, second]), len(first)
    tolerance = 1e-12 * max(1.0, float(np.abs(pooled).max()))  # equal sums in another order
    least = abs(first.mean() - second.mean()) - tolerance
    if math.comb(len(pooled), count) <= permutations:
        chosen = np.array(list(combinations(range(len(pooled)), count)))
        sums = pooled[chosen].sum(axis=1)
        differences = np.abs(sums / count - (pooled.sum() - sums) / (len(pooled) - count))
        return float(np.mean(differences >= least))
    shuffled = np.random.default_rng(seed).permuted(np.tile(pooled, (permutations, 1)), axis=1)
    differences = np.abs(shuffled[:, :count].mean(axis=1) - shuffled[:, count:].mean(axis=1))
    return float((1 + np.count_nonzero(differences >= least)) / (1 + permutations))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return `p_values` corrected for their number by Holm's step-down method (1979)."""
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    steps = np.asarray(p_values, dtype=np.float64)[order] * np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(steps))
    return corrected.tolist()
