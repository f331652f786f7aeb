"""`shes resume`: go on with a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_in, options_of


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes resume` takes beside the settings."""

    run: Annotated[Path, Shown(metavar="RUN", noun="a run folder")]
    """The run folder."""


def _groups(words: Sequence[str] = ()) -> tuple[Group, ...]:
    del words  # its help shows no values: they are the run's own
    from shes.cli.settings import asked_config, setting_groups

    settings = setting_groups(asked_config([]), only_execution=True)
    return (Group(heading="run folder", options=options_of(Arguments)), *settings)


def _explain_unknown(flag: str) -> str | None:
    """Say why a flag of `train` is none of `resume`."""
    from shes.runs.config import known_settings

    name = flag.removeprefix("--").removeprefix("no-").replace("-", "_")
    if name not in known_settings():
        return None
    allowed = ", ".join(sorted(option.flags[0] for option in options_in(_groups()) if option.flags))
    return f"{flag} would change the numbers of the run; resume takes {allowed}. Start another run to change it."


def _run(values: dict[str, Any]) -> int:
    from shes.cli.progress import show_progress
    from shes.training.train import resume

    run: Path = values.pop("run")
    # As text: of a shipped agent by name it is to say what may be done instead.
    return show_progress(lambda display: resume(str(run), listener=display, **values), run)


COMMAND = Command(
    name="resume",
    description="Go on with a run as if it had never stopped. What is not given stays as it is.",
    examples=("shes resume runs/first", "shes resume runs/first --generations 200 --workers 4"),
    groups=_groups,
    run=_run,
    explain_unknown=_explain_unknown,
)
