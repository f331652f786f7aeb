"""The subcommands: a module each, with its `COMMAND`. A new one is one file here and one line below."""

from __future__ import annotations

import importlib

from shes.cli.command import Command

__all__ = ["SUMMARIES", "load_command"]

SUMMARIES: dict[str, str] = {
    "envs": "list the environments",
    "list": "list the shipped agents",
    "train": "train on an environment",
    "resume": "go on with a run, to the bit",
    "evaluate": "evaluate a checkpoint of a run on fresh episodes",
    "plot": "draw the learning curves of runs",
    "render": "make a video of a run's policy",
    "watch": "look at a run's policy in a window",
    "experiment": "run a study of many runs, with tables and figures",
    "bench": "measure how fast this machine is",
    "completion": "complete commands, flags and names by the tab key",
}
"""What the commands do, by name, in the order of the help."""


def load_command(name: str) -> Command:
    """Return a command; its module is imported now, so that `shes --help` need not wait for all of them."""
    return importlib.import_module(f"shes.cli.commands.{name}").COMMAND
