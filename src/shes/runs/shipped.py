"""Shipped agents: trained agents that are part of the package, and stand by name wherever a run folder may.

Each is a small run folder below `agents/`, with `agent.json` beside its `config.json`; `ship` makes one out of a run.
"""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from shes.errors import RunFolderError, UnknownNameError, nearest_first

__all__ = [
    "AGENT_FILE",
    "FreshEvaluation",
    "ShippedAgent",
    "find_run",
    "read_agent",
    "run_text",
    "shipped_hint",
    "shipped_name",
    "shipped_names",
    "shipped_path",
]

AGENTS = Path(str(files("shes") / "agents"))
"""Where the shipped agents are."""
AGENT_FILE = "agent.json"
"""What is told of an agent; a folder without it is none."""


@dataclass(frozen=True, kw_only=True)
class FreshEvaluation:
    """An agent's result on fresh episodes, as `shes evaluate NAME --episodes ... --seed ...` gives it again."""

    episodes: int
    score_mean: float
    score_std: float
    return_mean: float
    success_rate: float
    episode_steps_mean: float
    seed: int | None
    """Seed of the episodes; None is a stream of the run's own, apart from its training."""


@dataclass(frozen=True, kw_only=True)
class ShippedAgent:
    """What `agent.json` tells of a shipped agent."""

    description: str
    """What it does, on one line."""
    env: str
    """The environment that it was trained on."""
    commands: tuple[str, ...]
    """The commands that made it."""
    cores: int
    """Cores that its run had."""
    hours: float
    """Wall-clock time of its run, in hours."""
    env_steps: int
    """Environment steps of its run."""
    generation: int
    """The generation of its run that it is of: the one with the best evaluation."""
    evaluation: FreshEvaluation

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return {**asdict(self), "commands": list(self.commands)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ShippedAgent:
        """Return what `to_dict` wrote.

        Raises:
            KeyError: `commands` or `evaluation` is missing.
            TypeError: Another key is missing, or unknown.
        """
        evaluation = FreshEvaluation(**values["evaluation"])
        return cls(**{**values, "commands": tuple(values["commands"]), "evaluation": evaluation})


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped agents, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in AGENTS.glob(f"*/{AGENT_FILE}")))


def shipped_path(name: str) -> Path:
    """Return the folder of the shipped agent `name`.

    Raises:
        UnknownNameError: There is none of this name.
    """
    if name not in shipped_names():
        raise UnknownNameError("shipped agent", name, shipped_names(), "`shes list` shows them.")
    return AGENTS / name


def shipped_name(path: Path) -> str | None:
    """Return the name of the shipped agent whose folder `path` is; None if it is no place of a shipped agent."""
    place = path.resolve()
    return place.name if place.parent == AGENTS.resolve() else None


def read_agent(name: str) -> ShippedAgent:
    """Return what is told of the shipped agent `name`.

    Raises:
        UnknownNameError: There is none of this name.
        RunFolderError: Its `agent.json` is damaged.
    """
    file = shipped_path(name) / AGENT_FILE
    try:
        return ShippedAgent.from_dict(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file} is damaged: {error!r}. Install SHES again.") from error


def find_run(run: Path | str) -> Path:
    """Return the folder that `run` means: the path itself, or the shipped agent of this name.

    Only a string can be a name. A path that exists wins over a name, and `./name` or a `pathlib.Path` is always a path.
    """
    if isinstance(run, str) and run in shipped_names() and not os.path.lexists(run):
        return AGENTS / run
    return Path(run)


def run_text(run: Path | str) -> str:
    """Return `run` as text that means the same: a path object without a separator gets `./`, as it is no name."""
    given = os.fspath(run)
    return given if isinstance(run, str) or os.sep in given else f".{os.sep}{given}"


def shipped_hint(run: Path | str) -> str:
    """Return what an error says of shipped agents where `run` is no run folder; nothing if there are none."""
    given, names = os.fspath(run), shipped_names()
    if given in names and not os.path.lexists(given):
        return f" A pathlib.Path is always a path: for the shipped agent of this name, give the string {given!r}."
    if given in names:
        return f" It hides the shipped agent {given}: rename it, or work in another folder, to use that one."
    if not names or os.sep in given:
        return ""
    close = difflib.get_close_matches(given, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return f" Or name a shipped agent: {', '.join(nearest_first(given, names))}.{hint}"
