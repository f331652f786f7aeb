"""An experiment as data: its runs, what is compared by which measure, and its figures."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from shes.errors import ConfigError, UnknownNameError
from shes.evolution.hyperparameters import is_alone, is_branched, learns
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config, preset_values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from experiments.results import PlacedResults

_Size = TypeVar("_Size")
ALONE: Mapping[str, Any] = MappingProxyType({"backend": "serial", "num_workers": 1})
"""Settings of a run that is its own worker."""
Place = tuple[str, str, str]
"""Environment, group and variant."""
SMOKE: Mapping[str, Any] = MappingProxyType(
    {
        "population_size": 8,
        "horizon": 50,
        "evaluation_horizon": 50,
        "evaluation_episodes": 2,
        "evaluation_interval": 2,
        "noise_table_size": 1_000_000,
    }
)
"""Settings of a test, too short to learn."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of an experiment."""

    group: str
    """Group of variants."""
    variant: str
    """Name of the changed settings; runs of a variant differ only in the seed."""
    env: str
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings by name that differ from those of the preset."""
    primitive: Run | None = None
    """The run whose primitive it takes."""
    preset: str = "laptop"

    @property
    def name(self) -> str:
        """Its name, which is the path of its run folder below that of the experiment."""
        return f"{self.env}/{self.group}/{self.variant}/seed-{self.seed}"

    @property
    def place(self) -> Place:
        """Its place in tables and figures."""
        return self.env, self.group, self.variant

    @property
    def identity(self) -> dict[str, Any]:
        """The columns that identify it in tables."""
        return {"group": self.group, "variant": self.variant, "env": self.env, "seed": self.seed}

    @cached_property
    def digest(self) -> str:
        """Digest of its settings, its preset's and its primitive's included: eight digits, the same for every seed."""
        values = {**preset_values(self.env, self.preset, self.settings), **self.settings}
        source = self.primitive
        primitive = None if source is None else [source.env, source.group, source.variant, source.digest]
        return hashlib.sha256(json.dumps([values, primitive], sort_keys=True).encode()).hexdigest()[:8]

    def config(self, out: Path, workers: Mapping[str, Any] = ALONE) -> TrainConfig:
        """Return the settings of the run below `out`, where the run of its primitive exists.

        Its own backend and number of workers take precedence over `workers`.
        """
        transfer = {} if self.primitive is None else {"primitive": out / self.primitive.name}
        return make_config(self.env, self.preset, {**workers, **self.settings, **transfer, "seed": self.seed})

    def planned_config(self) -> TrainConfig:
        """Return the settings of the run before its primitive is there.

        A frozen primitive plays no branches, and a search for a way would be refused without the primitive's view.
        """
        settings = {name: value for name, value in self.settings.items() if name != "freeze_primitive"}
        if self.primitive is not None:
            settings = {name: value for name, value in settings.items() if not name.startswith("explore")}
            if self.settings.get("freeze_primitive", True):
                settings["primitive_estimate"] = "episode"
        return make_config(self.env, self.preset, settings)


class Variant(NamedTuple):
    """Runs that differ from the base in some settings."""

    words: str
    """Its name in tables and figures."""
    changes: Mapping[str, Any]
    """Settings that differ from those of the base."""


class Measure(NamedTuple):
    """A column of a table, and its name in words."""

    column: str
    words: str


class Pair(NamedTuple):
    """A further comparison: a variant with one that is not the base. Both are a group and a variant."""

    first: tuple[str, str]
    second: tuple[str, str]
    env: str = ""
    """The environment that it is for; all if empty."""


DrawFigure = Callable[["PlacedResults"], "Figure | None"]
"""A function that draws a figure of the results; None if there is nothing to draw."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """The runs of an experiment, and what is made of them."""

    runs: tuple[Run, ...]
    groups: Mapping[str, str]
    """Groups of runs, with their questions."""
    base: tuple[str, str]
    """Group and variant with which the others are compared."""
    metrics: Mapping[str, Measure]
    """Column of `runs.csv` that is compared, by environment: a result on fresh episodes."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Names of variants in words."""
    pairs: tuple[Pair, ...] = ()
    figures: Mapping[str, DrawFigure] = field(default_factory=dict)
    """Figures by the name of their file."""
    episodes: int = 100
    """Number of fresh episodes on which the checkpoints of a finished run are evaluated."""
    has_large_runs: bool = False
    """Whether every run has all workers for itself; otherwise each has one core, and several run at a time."""
    has_ratios: bool = False
    """Whether variants are compared by the ratios of each seed, too, as times are."""
    has_equal_budgets: bool = False
    """Whether test scores are compared over equal environment steps and equal time, too."""

    def label(self, variant: str) -> str:
        """Return the name of a variant in words."""
        return self.labels.get(variant, variant.replace("-x", " × ").replace("-", " "))

    def stages(self) -> tuple[list[Run], list[Run]]:
        """Return the runs in two stages, each ordered by seed: those whose primitive another one takes, and the others.

        An experiment that was stopped has about as many seeds of every variant.
        """
        taken = {run.primitive.name for run in self.runs if run.primitive is not None}
        ordered = sorted(self.runs, key=lambda run: run.seed)
        return [run for run in ordered if run.name in taken], [run for run in ordered if run.name not in taken]

    def ordered(self) -> list[Run]:
        """Return the runs in the order of execution."""
        return [run for stage in self.stages() for run in stage]

    def only(self, parts: Sequence[str]) -> Experiment:
        """Return the experiment with the runs of `parts`, groups or environments; all if there are none.

        Groups come with the base, and runs with those whose primitive they take.
        """
        known = {**self.groups, **dict.fromkeys(sorted({run.env for run in self.runs}))}
        for part in parts:
            if part not in known:
                raise UnknownNameError("group or environment", part, known, "Set --only.")
        groups, envs = set(parts) & self.groups.keys(), set(parts) - self.groups.keys()
        chosen = {
            part.name
            for run in self.runs
            if (not envs or run.env in envs)
            and (not groups or run.group in groups or (run.group, run.variant) == self.base)
            for part in (run, run.primitive)
            if part is not None
        }
        return replace(self, runs=tuple(run for run in self.runs if run.name in chosen))


def within(group: str, *pairs: tuple[str, str]) -> tuple[Pair, ...]:
    """Return pairs of variants of one group."""
    return tuple(Pair((group, first), (group, second)) for first, second in pairs)


def find_size(scale: str, sizes: Mapping[str, _Size], seeds: int | None) -> _Size:
    """Return the size of a scale; raise UnknownNameError or ConfigError unless it and `seeds` are possible."""
    if scale not in sizes:
        raise UnknownNameError("scale", scale, sizes, "Set --scale.")
    if seeds is not None and not 1 <= seeds <= 1000:
        raise ConfigError(f"seeds must be a whole number between 1 and 1000, got {seeds}. Set --seeds.")
    return sizes[scale]


def sweep_name(setting: str, factor: float) -> str:
    """Return the name of the variant with `factor` times the base's `setting`."""
    return f"{setting.replace('_', '-')}-x{factor:g}"


def multiplied(base: Mapping[str, Any], name: str, factor: float) -> dict[str, Any]:
    """Return setting `name` at `factor` times the base's; integers stay integers, populations multiples of four."""
    value = factor * base[name]
    if name == "population_size":
        return {name: 4 * whole(value / 4)}
    return {name: whole(value) if isinstance(base[name], int) else value}


def generation_steps(config: TrainConfig) -> int:
    """Return the environment steps of a generation of evolution if no episode and no branch ends early."""
    evolution = config.evolution
    episodes = evolution.population_size * evolution.episodes_per_policy * config.episodes.horizon
    if not is_branched(config) or not learns(config)[-1]:
        return episodes
    members = config.values.get("primitive_population_size") or evolution.population_size
    branches = members * config.estimate.intervals * config.hierarchy.controller_interval
    return branches if is_alone(config) else episodes + branches


def whole(value: float) -> int:
    """Return the nearest integer of at least 1; halves are rounded up."""
    return max(1, math.floor(value + 0.5))
