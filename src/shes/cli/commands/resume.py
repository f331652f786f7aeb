"""`shes resume`: go on with a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from shes.cli.parsing import ExecutionFlags
from shes.cli.progress import show_progress
from shes.training.train import resume as go_on


def resume(run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")], settings: ExecutionFlags) -> int:
    """Go on with a run as if it had never stopped. What is not given stays as it is.

    shes resume runs/first --generations 200 --workers 4

    Args:
        run: The run folder.
        settings: Settings by name.
    """
    return show_progress(lambda display: go_on(run, listener=display, **settings), Path(run))
