"""Names and charts of an experiment, which `shes experiment` writes beside its tables as NAME-design.json.

A report reads them there, because it may not import the studies.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict, cast

SUFFIX = "-design.json"


class DesignedCurve(TypedDict):
    """A curve: the runs of a variant."""

    group: str
    variant: str
    words: str
    is_after_primitive: bool
    """Whether it begins where the training of its primitive ended: runs without that time are not drawn."""


class DesignedReference(TypedDict):
    """A published result: a horizontal line."""

    words: str
    value: float


class DesignedChart(TypedDict):
    """A chart of learning curves."""

    env: str
    title: str
    column: str
    """Column of `curves.csv`."""
    words: str
    """That column in words."""
    axes: list[str]
    """Abscissae, the first by default: `env_steps`, `wall_time_s`."""
    curves: list[DesignedCurve]
    references: list[DesignedReference]
    has_running_best: bool
    """Whether the mean of the running maxima is drawn, too, as a dashed line."""


class Series(TypedDict):
    """Published speed-ups."""

    words: str
    cores: list[float]
    speedup: list[float]
    color: int
    """Number of the curve with its colour; -1 for one of no curve."""
    is_line: bool
    """Whether it is a line; otherwise it is single points."""


class DesignedSpeedup(TypedDict):
    """A chart of the speed-up over cores."""

    env: str
    title: str
    curves: list[DesignedCurve]
    series: list[Series]
    kinds: dict[str, str]
    """Kinds of rows of `curves.csv` in words."""


class ExperimentDesign(TypedDict):
    """Names and charts of an experiment."""

    title: str
    groups: dict[str, str]
    """Groups of runs, with their questions."""
    variants: dict[str, dict[str, str]]
    """Names of the variants of each group in words, in the order of the experiment."""
    charts: list[DesignedChart]
    speedups: list[DesignedSpeedup]


class Designs:
    """The designs of the experiments that share a folder."""

    def __init__(self, by_name: dict[str, ExperimentDesign]) -> None:
        """Take the designs by the name of their table, such as `fig3`."""
        self.by_name = by_name
        self._words = {
            (group, variant): words
            for design in by_name.values()
            for group, variants in design["variants"].items()
            for variant, words in variants.items()
        }

    @property
    def questions(self) -> dict[str, str]:
        """Groups of runs, with their questions."""
        return {group: words for design in self.by_name.values() for group, words in design["groups"].items()}

    @property
    def places(self) -> Sequence[tuple[str, str]]:
        """Groups and variants, in the order of the experiments."""
        return list(self._words)

    def title(self, name: str) -> str:
        """Return the title of the experiment `name`; without its design, the name."""
        return self.by_name[name]["title"] if name in self.by_name else name

    def variant(self, group: str, variant: str) -> str:
        """Return the name of a variant in words; without a design, its name."""
        return self._words.get((group, variant), variant)

    def method(self, group: str, variant: str) -> str:
        """Return group and variant in words."""
        return f"{group}, {self.variant(group, variant)}"


def design_text(design: ExperimentDesign) -> str:
    """Return the content of a file of `design`."""
    return json.dumps(design, indent=1, ensure_ascii=False) + "\n"


_AGAIN = "Write it again: shes experiment NAME --no-run"


def read_design(folder: Path, name: str) -> ExperimentDesign | None:
    """Return the design of the experiment `name` in `folder`, None without one; for the errors see `read_designs`."""
    file = folder / f"{name}{SUFFIX}"
    return _checked_design(file) if file.exists() else None


def _checked_design(file: Path) -> ExperimentDesign:
    """Return what a file of a design holds; raise ValueError if it is none."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file.name} is not JSON: {error}") from error
    if not isinstance(content, dict) or not ExperimentDesign.__required_keys__ <= content.keys():
        raise ValueError(f"{file.name} is no design of an experiment")
    return cast("ExperimentDesign", content)


def read_designs(folder: Path) -> Designs:
    """Return the designs of the experiments in `folder`; empty without any.

    Raises:
        ValueError: A file is no design.
        OSError: A file cannot be read.
    """
    files = sorted(folder.glob(f"*{SUFFIX}"))
    try:
        return Designs({file.name.removesuffix(SUFFIX): _checked_design(file) for file in files})
    except ValueError as error:
        raise ValueError(f"{error}. {_AGAIN}") from error
    except (KeyError, TypeError, AttributeError) as error:
        names = ", ".join(file.name for file in files)
        raise ValueError(f"one of {names} is damaged: {error!r}. {_AGAIN}") from error
