"""`shes info`: what a run is and how far it came."""

from __future__ import annotations

import json as json_text
from typing import Annotated, Any

import tyro

from shes.cli.output import print_facts
from shes.runs.folder import RunFolder
from shes.runs.state import run_state


def info(
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")], *, full: bool = False, json: bool = False
) -> int:
    """Show what a run is and how far it came.

    Args:
        run: The run folder, or the name of a shipped agent.
        full: Show every setting, too.
        json: Print one JSON object, with every setting.
    """
    folder = RunFolder.open(run)
    record, config = folder.read_record(), folder.read_config()
    facts: dict[str, Any] = {
        **run_state(folder).to_dict(),
        "levels": ", ".join(config.level_names),
        "started": record.get("started"),
        "command": " ".join(record.get("command", [])),
    }
    if json:
        print(json_text.dumps({**facts, "config": record["config"]}))
        return 0
    if full:
        facts |= {name: value for room in config.to_dict().values() for name, value in room.items()}
    print_facts(facts, as_json=False)
    return 0
