"""Listings of runs and shipped agents: those below a folder, and the settings and the state of one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shes.listing import Listing, Table, facts_listing
from shes.runs.folder import RunFolder
from shes.runs.shipped import FreshEvaluation, read_agent, shipped_name, shipped_names
from shes.runs.state import RunState, run_state, states_below, unregistered_state


def list_runs(folder: Path | str = "runs") -> Listing:
    """List the runs below a folder, and the shipped agents. The name of an agent can be given instead of a run.

    Args:
        folder: The folder.
    """
    runs, agents = states_below(Path(folder)), {name: read_agent(name) for name in shipped_names()}
    parts: list[Table | str] = [f"There is no run below {folder}."]
    if runs:
        parts = [Table(("run", "environment", "generation", "best score", "state"), list(map(_row, runs)))]
    parts += [f"{run.run} is {run.state}: {run.problem}" for run in runs if run.problem is not None]
    if agents:
        rows = [(name, it.env, *_scores(it.evaluation), f"{it.env_steps:,}") for name, it in agents.items()]
        parts += [
            Table(("agent", "environment", "score", "constant", "random", "steps"), rows),
            "Score: mean and standard error over fresh episodes. Steps: environment steps of training.",
            "Constant, random: score with the best constant controller, and with random goals, on the same episodes.",
            *(f"{name} {agent.description.rstrip('.')}." for name, agent in agents.items()),
        ]
    shown = {name: agent.to_dict() for name, agent in agents.items()}
    return Listing({"runs": [run.to_dict() for run in runs], "agents": shown}, parts)


def _scores(found: FreshEvaluation) -> list[str]:
    """Return the score of an agent, and those of the other controllers."""
    return ["-" if each is None else each.score for each in (found, found.constant, found.random)]


def _row(run: RunState) -> tuple[str, ...]:
    """Return the cells of a run's row."""
    done, total = ("-" if each is None else each for each in (run.generation, run.generations))
    score = "-" if run.best_score is None else f"{run.best_score:.2f}"
    return run.run, run.env or "-", f"{done} / {total}", score, run.state


def describe_run(run: Path | str, *, full: bool = False) -> Listing:
    """Show the state of a run, and with --full its settings; of a shipped agent its result and how it was trained.

    Args:
        run: The run folder, or the name of a shipped agent.
        full: Show all settings. JSON always has them.

    Raises:
        RunFolderError: `run` is neither a run folder nor a shipped agent.
    """
    folder = RunFolder.open(run)
    if unregistered := unregistered_state(folder):
        return facts_listing(unregistered.to_dict())
    record, config = folder.read_record(), folder.read_config()
    levels, name = ", ".join(config.level_names), shipped_name(folder.path)
    parts: list[Table | str] = []
    if name is None:
        facts: dict[str, Any] = {
            **run_state(folder).to_dict(),
            "levels": levels,
            "started": record.get("started"),
            "command": " ".join(record.get("command", [])),
        }
        del facts["problem"]  # of a run that cannot be read
        shown = facts
    else:
        agent = read_agent(name)
        facts = {"agent": name, "algorithm": config.run.algorithm, "levels": levels, **agent.to_dict()}
        shown = {each: facts[each] for each in ("agent", "env", "algorithm", "levels", "env_steps", "hours", "cores")}
        shown["score"] = f"{agent.evaluation.score} over {agent.evaluation.episodes} fresh episodes"
        for each in (agent.evaluation.constant, agent.evaluation.random):
            if each is not None:
                shown[f"score, {each.controller}"] = each.score
        parts = [f"It {agent.description.rstrip('.')}. Trained by:", *agent.commands]
    settings = {each: value for section in config.to_dict().values() for each, value in section.items()} if full else {}
    listing = facts_listing({**shown, **settings})
    return Listing({**facts, "config": record["config"]}, [*listing.parts, *parts])
