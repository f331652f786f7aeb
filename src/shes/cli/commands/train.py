"""`shes train`: begin a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes train` takes beside the settings."""

    out: Annotated[Path | None, Shown(metavar="FOLDER")] = None
    """The run folder, which must not hold a run yet; a new one below runs/ if none."""


def _groups(words: Sequence[str]) -> tuple[Group, ...]:
    from shes.cli.settings import asked_config, environment_group, setting_groups

    config = asked_config(words)
    run, *others = setting_groups(config)
    run = Group(heading=run.heading, options=(*run.options, *options_of(Arguments)))
    return (environment_group(is_required=True), run, *others)


def _notes(words: Sequence[str]) -> str:
    from shes.cli.settings import asked_config

    config = asked_config(words)
    return (
        f"The values shown are those of the preset {config.run.preset!r} for {config.run.env}; "
        f"`shes train ENV --preset NAME --help` shows others."
    )


def _explain_unknown(flag: str) -> str | None:
    return f"the environment comes first, without a flag: shes train ENV; got {flag}." if flag == "--env" else None


def _run(values: dict[str, Any]) -> int:
    from shes.cli.progress import show_progress
    from shes.cli.settings import make_asked_config
    from shes.training.train import start_run

    out: Path | None = values.pop("out", None)
    config = make_asked_config(values)
    return show_progress(lambda display: start_run(config, out, display), out)


COMMAND = Command(
    name="train",
    description="Train on an environment, with live progress. Ctrl-C stops, and nothing is lost: shes resume goes on.",
    examples=(
        "shes train point-gather --generations 60 --out runs/first",
        "shes train ant-gather --preset paper --workers 8 --minutes 60 --seed 2",
    ),
    groups=_groups,
    run=_run,
    notes=_notes,
    explain_unknown=_explain_unknown,
)
