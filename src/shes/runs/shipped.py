"""Shipped agents: trained agents in the package, whose names can be given instead of a run folder.

Each is a small run folder below `shipped/`, with `agent.json` and `config.json`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

from shes.errors import ConfigError, RunFolderError, UnknownNameError, nearest_first

AGENTS = Path(str(files("shes") / "shipped"))
"""Folder of the shipped agents."""
AGENT_FILE = "agent.json"
"""Description of an agent; a folder without it is not an agent."""


@dataclass(frozen=True, kw_only=True)
class FreshScore:
    """Scores on fresh episodes."""

    controller: str | None
    """The controller that set the goals, as `Evaluation.controller`; None for an agent without a controller."""
    episodes: int
    score_mean: float
    score_std: float
    success_rate: float

    @classmethod
    def of(cls, facts: Mapping[str, Any], **others: Any) -> Self:
        """Return the result whose fields are among the `facts` of an evaluation and the `others`."""
        own: dict[str, Any] = {each.name: facts.get(each.name) for each in fields(cls)}
        return cls(**(own | others))

    @property
    def score(self) -> str:
        """Mean score and its standard error over the episodes, as text."""
        return f"{self.score_mean:.2f} ± {self.score_std / self.episodes**0.5:.2f}"


@dataclass(frozen=True, kw_only=True)
class FreshEvaluation(FreshScore):
    """An agent's result on fresh episodes: that of `shes evaluate NAME --episodes ... --seed ...`."""

    return_mean: float
    episode_steps_mean: float
    seed: int | None
    """Seed of the episodes; if None, from a stream of the run that its training does not use."""
    constant: FreshScore | None
    """Result of the best constant controller on the same episodes; None for an agent without a controller."""
    random: FreshScore | None
    """Result of random directions on the same episodes; None for an agent without a controller."""


@dataclass(frozen=True, kw_only=True)
class ShippedAgent:
    """The description of a shipped agent in `agent.json`."""

    description: str
    env: str
    commands: list[str]
    cores: int
    hours: float
    """Wall-clock time of its run, in hours."""
    env_steps: int
    generation: int
    """Generation of its run with the best evaluation, whose policies it has."""
    evaluation: FreshEvaluation

    @property
    def evaluations(self) -> tuple[FreshScore | None, ...]:
        """Its results, and those of the constant and the random controller."""
        return self.evaluation, self.evaluation.constant, self.evaluation.random


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped agents, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in AGENTS.glob(f"*/{AGENT_FILE}")))


def shipped_name(path: Path) -> str | None:
    """Return the name of the shipped agent in folder `path`; None if `path` is not below the folder of agents."""
    place = path.resolve()
    return place.name if place.parent == AGENTS.resolve() else None


def read_agent(name: str) -> ShippedAgent:
    """Return the description of the shipped agent `name`; raise RunFolderError if it is damaged."""
    if name not in shipped_names():
        raise UnknownNameError("shipped agent", name, shipped_names(), "`shes list` shows them.")
    file = AGENTS / name / AGENT_FILE
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        found = values["evaluation"]
        others = {name: found[name] and FreshScore(**found[name]) for name in ("constant", "random")}
        return ShippedAgent(**{**values, "evaluation": FreshEvaluation(**{**found, **others})})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file} is damaged: {error!r}. Install SHES again.") from error


def find_run(run: Path | str) -> Path:
    """Return the folder of `run`: the path itself, or that of the shipped agent of this name.

    An existing path takes precedence over a name; `./name` is always a path.
    """
    if not isinstance(run, str | os.PathLike) or not os.fspath(run):
        raise ConfigError(f"a run must be the path of its folder or the name of a shipped agent, got {run!r}.")
    given = os.fspath(run)
    return AGENTS / given if given in shipped_names() and not os.path.lexists(given) else Path(given)


def shipped_hint(run: Path | str) -> str:
    """Return a hint at shipped agents for the error that `run` is not a run folder; empty without agents."""
    given, names = os.fspath(run), shipped_names()
    if given in names:
        return f" It hides the shipped agent {given}: rename it, or work in another folder, to use that one."
    if not names or os.sep in given:
        return ""
    return f" Or name a shipped agent: {', '.join(nearest_first(given, names))}."
