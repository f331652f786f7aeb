"""`shes train`: begin a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from shes.cli.progress import show_progress
from shes.training.presets import make_config
from shes.training.train import start_run


def train(
    env: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ENV")],
    settings: dict[str, Any],
    *,
    out: Path | None = None,
) -> int:
    """Train on an environment, with live progress. Ctrl-C stops, and nothing is lost: shes resume goes on.

    shes train point-gather --generations 60 --out runs/first

    Args:
        env: Environment, see shes envs; or gymnasium:ID, one of Gymnasium.
        settings: Settings by name.
        out: The run folder, which must not hold a run yet; a new one below runs/ if none.
    """
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    return show_progress(lambda display: start_run(config, out, display), out)
