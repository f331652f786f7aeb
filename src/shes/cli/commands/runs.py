"""`shes list` and `shes info`: which runs there are, and what a run is."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import Annotated, Any

import tyro

from shes.cli.output import print_facts, print_line, print_table
from shes.cli.parsing import Json, Run
from shes.runs.folder import RunFolder
from shes.runs.shipped import read_agent, shipped_names
from shes.runs.state import RunState, run_state, unreadable_state


def list_(folder: Annotated[Path, tyro.conf.Positional] = Path("runs"), *, json: Json = False) -> int:
    """List the runs below a folder, and the shipped agents. The name of an agent can be given instead of a run.

    Args:
        folder: The folder.
    """
    runs = _runs_below(folder)
    agents = {name: read_agent(name) for name in shipped_names()}
    if json:
        shown = {name: agent.to_dict() for name, agent in agents.items()}
        print(json_text.dumps({"runs": [run.to_dict() for run in runs], "agents": shown}))
        return 0
    if runs:
        print_table(("run", "environment", "generation", "best score", "state"), list(map(_row, runs)))
    else:
        print_line(f"There is no run below {folder}.")
    for run in runs:
        if run.problem is not None:
            print_line(f"{run.run} is unreadable: {run.problem}")
    rows: list[tuple[str, ...]] = []
    for name, agent in agents.items():
        score = f"{agent.evaluation.score_mean:.2f} ± {agent.evaluation.score_std:.2f}"
        rows.append((name, agent.env, score, f"{agent.env_steps:,}", agent.description))
    if rows:
        print_table(("agent", "environment", "score", "steps", "description"), rows)
        print_line("Score: mean and standard deviation over fresh episodes. Steps: environment steps of training.")
    return 0


def _row(run: RunState) -> tuple[str, ...]:
    """Return the cells of a run's row."""
    generation, generations = ("-" if each is None else each for each in (run.generation, run.generations))
    return run.run, run.env or "-", f"{generation} / {generations}", run.shown_score, run.state


def _runs_below(folder: Path) -> list[RunState]:
    """Return the states of the runs below `folder`, in alphabetical order."""
    found: list[RunState] = []
    for file in sorted(folder.glob("**/config.json")):
        run = RunFolder(file.parent)
        if not (run.checkpoints.is_dir() or run.progress.is_file()):
            continue  # another program's config.json
        try:
            found.append(run_state(run))
        except Exception as error:  # noqa: BLE001 - one bad folder, whatever is in it, must not hide the other runs
            found.append(unreadable_state(run, error))
    return found


def info(run: Run, *, full: bool = False, json: Json = False) -> int:
    """Show the settings and the state of a run.

    Args:
        full: Show all settings. JSON always has them.
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
        facts["config"] = record["config"]
    elif full:
        facts |= {name: value for room in config.to_dict().values() for name, value in room.items()}
    print_facts(facts, as_json=json)
    return 0
