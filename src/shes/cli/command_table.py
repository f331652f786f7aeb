"""The commands by name, and the flags that stand anywhere on a command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import shes
from shes.errors import UnknownNameError

COMMANDS: dict[str, tuple[str, str]] = {
    "envs": ("envs.catalogue.list_environments", "list the environments"),
    "list": ("runs.listings.list_runs", "list the runs below runs/, and the shipped agents"),
    "info": ("runs.listings.describe_run", "show the settings and the state of a run"),
    "train": ("cli.commands.train", "train on an environment"),
    "resume": ("cli.commands.resume", "continue a run"),
    "evaluate": ("runs.evaluate.evaluate", "evaluate a checkpoint of a run on fresh episodes"),
    "plot": ("viewing.plot.plot", "plot the learning curves of runs"),
    "report": ("viewing.report.report", "make one HTML page of runs: curves, results, maps, videos, settings"),
    "compare": ("runs.comparison.compare_runs", "compare two runs, or groups of runs: interval and p value"),
    "render": ("viewing.render.render", "make a video of a run's policy"),
    "watch": ("viewing.watch.watch", "watch a run's policy in a window"),
    "export": ("runs.export.export", "write a run's policy to a file that needs no SHES"),
    "bench": ("cli.bench.bench", "measure the speed of this machine"),
    "completion": ("cli.commands.completion", "print a script that completes commands and flags with the Tab key"),
}
"""Function of every command, below `shes`, and its line in the overview."""
EVERYWHERE = ("--help", "--help-all", "--import", "--debug")
"""Flags of every command."""


def find_command(name: str) -> Callable[..., Any]:
    """Return the function of command `name`; raise UnknownNameError if there is none."""
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS, "See `shes --help`.")
    module, _, function = COMMANDS[name][0].rpartition(".")
    return getattr(shes.import_module(f"shes.{module}"), function)


def split_everywhere(words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return `modules` to import and `debug`, which may stand anywhere in `words`, and the other words."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--debug", action="store_true")
    parser.add_argument("--import", action="append", nargs="?", default=[], dest="modules")
    return parser.parse_known_args(words)
