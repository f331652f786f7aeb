"""`shes envs`, `list` and `info`: which environments, runs and shipped agents there are, and what a run is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from shes.cli.output import show
from shes.cli.parsing import Json, Run
from shes.envs.catalogue import environments_listing
from shes.runs.listings import run_listing, runs_listing


def envs(*, json: Json = False) -> int:
    """List the environments."""
    return show(environments_listing(), json)


def list_(folder: Annotated[Path, tyro.conf.Positional] = Path("runs"), *, json: Json = False) -> int:
    """List the runs below a folder, and the shipped agents. The name of an agent can be given instead of a run.

    Args:
        folder: The folder.
    """
    return show(runs_listing(folder), json)


def info(run: Run, *, full: bool = False, json: Json = False) -> int:
    """Show the settings and the state of a run.

    Args:
        full: Show all settings. JSON always has them.
    """
    return show(run_listing(run, full=full), json)
