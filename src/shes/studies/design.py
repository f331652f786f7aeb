"""The design of a study as data: groups of variants, measures, comparisons, figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

STEPS_PER_S = MappingProxyType({"point": 35_000, "ant": 10_000})
"""Environment steps per second of one core in a whole run, by body, for the forecast."""


class Variant(NamedTuple):
    """Runs that differ from the base in some settings."""

    words: str
    """Its name in tables and figures."""
    changes: Mapping[str, Any]
    """Settings that differ from those of the base."""


class Measure(NamedTuple):
    """A column of a study's table, and its name in words."""

    column: str
    words: str
    short: str = ""
    """Name for a narrow axis."""


@dataclass(frozen=True, kw_only=True)
class Forest:
    """A figure: a row per variant with its seeds, mean and p against the base; a panel per environment."""

    file: str
    group: str
    """The group that is drawn below the base."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A figure: the effect of factors of settings, with a panel per environment and setting."""

    file: str
    group: str
    settings: tuple[str, ...]
    factors: tuple[float, ...]
    """Factors of the base's values."""


class Curve(NamedTuple):
    """A line of a figure: the runs of a variant."""

    group: str
    variant: str
    words: str = ""
    """Its name in the legend; that of tables if empty."""
    is_after_primitive: bool = False
    """Whether it begins where the training of its primitive ended."""


class Reference(NamedTuple):
    """A published result: a horizontal line."""

    words: str
    value: float


class CurvePanel(NamedTuple):
    """A panel of learning curves."""

    env: str
    title: str
    curves: tuple[Curve, ...]
    measure: Measure | None = None
    """Column of `curves.csv`; that of the environment if None."""
    x: Literal["env_steps", "hours"] = "env_steps"
    """Abscissa: environment steps or time, each in a unit that suits the longest curve."""
    references: tuple[Reference, ...] = ()
    has_running_best: bool = False
    """Whether the mean of the running maxima is drawn, too, as a dashed line."""


@dataclass(frozen=True, kw_only=True)
class Curves:
    """A figure: panels of learning curves."""

    file: str
    groups: tuple[str, ...]
    """Groups of which a finished cell is needed."""
    panels: tuple[CurvePanel, ...]
    columns: int | None = None
    """Panels in a row; all if None."""
    references_note: str = "published results"
    """Description of the references, for the legend."""


@dataclass(frozen=True, kw_only=True)
class Speedup:
    """A figure: speed-up over the number of cores, with a line per variant."""

    file: str
    group: str


@dataclass(frozen=True, kw_only=True)
class StudyDesign:
    """The comparisons and figures of a study."""

    groups: Mapping[str, str] = field(default_factory=dict)
    """Groups of cells, with their questions."""
    base: tuple[str, str] = ("", "base")
    """Group and variant of the base, with which the others are compared."""
    metrics: Mapping[str, Measure] = field(default_factory=dict)
    """Column of `runs.csv` that is compared, by environment: a result on fresh episodes."""
    curves: Mapping[str, Measure] = field(default_factory=dict)
    """Column of `curves.csv` that learning curves show, by environment."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Names of variants in words."""
    paired: tuple[tuple[tuple[str, str], tuple[str, str]], ...] = ()
    """Further comparisons, of the second with the first: groups and variants."""
    paired_on: Mapping[str, tuple[tuple[tuple[str, str], tuple[str, str]], ...]] = field(default_factory=dict)
    """The same of single environments."""
    has_ratios: bool = False
    """Whether variants are compared by the ratios of each seed, too, as times and speed-ups are."""
    has_equal_budgets: bool = False
    """Whether learning curves are compared over equal environment steps and equal time, where runs have different
    ones."""
    figures: tuple[Forest | Sweep | Curves | Speedup, ...] = ()
    formats: tuple[str, ...] = ("png",)
    """File formats of every figure."""
    slower: Mapping[str, int] = field(default_factory=dict)
    """Environment steps per second of one core, as in STEPS_PER_S, of variants that are slower."""

    def label(self, variant: str) -> str:
        """Return the name of a variant in words."""
        return self.labels.get(variant, variant.replace("-x", " × ").replace("-", " "))

    def authors(self, variant: str) -> str:
        """Return the key of a variant in `shes.studies.speedup_figure.PAPER_SECONDS`; empty for one of this package."""
        return {self.base[1]: "shes", "es": "es"}.get(variant, "")

    def metric(self, env: str) -> Measure:
        """Return the measure compared on `env`; the score if none is."""
        return self.metrics.get(env, Measure("best_score", "score"))


def within(group: str, *pairs: tuple[str, str]) -> tuple[tuple[tuple[str, str], tuple[str, str]], ...]:
    """Return pairs of variants of one group as `StudyDesign.paired` has them."""
    return tuple(((group, first), (group, second)) for first, second in pairs)


def sweep_name(setting: str, factor: float) -> str:
    """Return the name of the variant with `factor` times the base's `setting`."""
    return f"{setting.replace('_', '-')}-x{factor:g}"


def multiplied(base: Mapping[str, Any], name: str, factor: float) -> dict[str, Any]:
    """Return setting `name` at `factor` times the base's; integers stay integers, populations multiples of four."""
    value = factor * base[name]
    if name == "population_size":
        return {name: 4 * whole(value / 4)}
    return {name: whole(value) if isinstance(base[name], int) else value}


def whole(value: float) -> int:
    """Return the nearest integer of at least 1; halves are rounded up."""
    return max(1, math.floor(value + 0.5))
