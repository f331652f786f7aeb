"""`shes list`: the runs below runs/, and the shipped agents."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated

import tyro

from shes.cli.output import print_line, print_table
from shes.errors import ShesError
from shes.runs.folder import RunFolder
from shes.runs.shipped import read_agent, shipped_names
from shes.runs.state import RunState, run_state


def list_(folder: Annotated[Path, tyro.conf.Positional] = Path("runs"), *, json: bool = False) -> int:
    """List the runs below a folder, and the shipped agents. A name of an agent stands wherever a run may.

    Args:
        folder: The folder.
        json: Print one JSON object: runs, and agents by name.
    """
    runs = _runs_below(folder)
    agents = {name: read_agent(name) for name in shipped_names()}
    if json:
        told = {name: agent.to_dict() for name, agent in agents.items()}
        print(json_text.dumps({"runs": [run.to_dict() for run in runs], "agents": told}))
        return 0
    if runs:
        print_table(
            ("run", "environment", "generation", "best score", "state"),
            [(run.run, run.env, f"{run.generation} / {run.generations}", run.shown_score, run.state) for run in runs],
        )
    else:
        print_line(f"There is no run below {folder}.")
    if agents:
        rows = [
            (
                name,
                agent.env,
                f"{agent.evaluation.score_mean:.2f} ± {agent.evaluation.score_std:.2f}",
                f"{agent.env_steps:,}",
                agent.description,
            )
            for name, agent in agents.items()
        ]
        print_table(("agent", "environment", "score", "steps", "description"), rows)
        print_line("Score: mean and standard deviation over fresh episodes. Steps: environment steps of its training.")
    return 0


def _runs_below(folder: Path) -> list[RunState]:
    """Return what there is to say of the runs below `folder`, in alphabetical order; what is no run is left out."""
    found: list[RunState] = []
    for file in sorted(folder.glob("**/config.json")):
        try:
            found.append(run_state(RunFolder(file.parent)))
        except ShesError:
            continue
    return found
