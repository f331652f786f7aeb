"""What a study asks, as data: groups of variants, what is measured and compared, which figures are drawn of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from shes.errors import ConfigError, UnknownNameError

__all__ = ["Curve", "CurvePanel", "Curves", "Forest", "Measure", "StudyDesign", "Sweep", "check_size", "multiplied"]
__all__ += ["sweep_name", "whole"]


class Measure(NamedTuple):
    """A column of a table of a study, and its words."""

    column: str
    words: str
    short: str = ""
    """Words for a narrow axis."""


@dataclass(frozen=True, kw_only=True)
class Forest:
    """A figure: variants below each other, each with its seeds, its mean and its p against the base."""

    file: str
    group: str
    """The group that is drawn, the base above it; a panel per environment."""

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups without which there is nothing to draw."""
        return (self.group,)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A figure: what factors do to settings, a panel per environment and setting."""

    file: str
    group: str
    settings: tuple[str, ...]
    factors: tuple[float, ...]
    """What the base's values are multiplied by; the base itself is the 1."""

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups without which there is nothing to draw."""
        return (self.group,)


class Curve(NamedTuple):
    """A line of a figure: the runs of a variant."""

    group: str
    variant: str
    words: str = ""
    """What the legend calls it; as tables do if empty."""


class CurvePanel(NamedTuple):
    """Lines that are drawn over each other."""

    env: str
    title: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, kw_only=True)
class Curves:
    """A figure: learning curves, panel beside panel."""

    file: str
    groups: tuple[str, ...]
    """Groups without which there is nothing to draw."""
    panels: tuple[CurvePanel, ...]


@dataclass(frozen=True, kw_only=True)
class StudyDesign:
    """What a study asks beside its cells."""

    groups: Mapping[str, str] = field(default_factory=dict)
    """Groups of cells, and what they ask."""
    base: tuple[str, str] = ("", "base")
    """Group and variant that everything is compared with."""
    metrics: Mapping[str, Measure] = field(default_factory=dict)
    """What is compared on each environment, on fresh episodes: column of `runs.csv`."""
    curves: Mapping[str, Measure] = field(default_factory=dict)
    """What learning curves show of each environment: column of `curves.csv`."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Variants in words."""
    paired: Mapping[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    """Variants of a group that are compared with each other, too: second with first."""
    figures: tuple[Forest | Sweep | Curves, ...] = ()
    steps_per_s: int = 30_000
    """Environment steps per second of one core, all of a run included, for the forecast."""

    def label(self, variant: str) -> str:
        """Return a variant in words."""
        return self.labels.get(variant, variant.replace("-x", " × ").replace("-", " "))

    def metric(self, env: str) -> Measure:
        """Return what is compared on `env`; the score where nothing is."""
        return self.metrics.get(env, Measure("best_score", "score"))


def check_size(scale: str, seeds: int | None, scales: Mapping[str, Any]) -> None:
    """Refuse a size that a study does not have.

    Raises:
        UnknownNameError: There is no such scale.
        ConfigError: `seeds` is not positive.
    """
    if scale not in scales:
        raise UnknownNameError("scale", scale, scales, "Set --scale.")
    if seeds is not None and seeds < 1:
        raise ConfigError(f"seeds must be a whole number of at least 1, got {seeds}. Set --seeds.")


def sweep_name(setting: str, factor: float) -> str:
    """Return the variant whose `setting` is `factor` times the base's."""
    return f"{setting.replace('_', '-')}-x{factor:g}"


def multiplied(base: Mapping[str, Any], name: str, factor: float) -> dict[str, Any]:
    """Return setting `name` at `factor` times the base's: whole where that is, a population of whole groups of four."""
    value = factor * base[name]
    if name == "population_size":
        return {name: 4 * whole(value / 4)}
    return {name: whole(value) if isinstance(base[name], int) else value}


def whole(value: float) -> int:
    """Return the nearest whole number, at least 1; a half is rounded up."""
    return max(1, math.floor(value + 0.5))
