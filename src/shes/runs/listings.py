"""The listings of `shes list` and `shes info`: the state of runs, and what is shipped."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from shes.errors import ShesError
from shes.runs.folder import RunFolder
from shes.runs.model_card import model_card
from shes.runs.shipped import read_agent, shipped_name, shipped_names
from shes.runs.tables import read_csv
from shes.types import Listing, Table, facts_listing


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The state of a run. Fields that cannot be read are None."""

    run: str
    env: str | None = None
    algorithm: str | None = None
    preset: str | None = None
    seed: int | None = None
    generation: int | None = None
    """Number of finished generations."""
    generations: int | None = None
    """Number of generations after which it ends."""
    env_steps: int | None = None
    best_score: float | None = None
    """Score of the best evaluation; None before the first one."""
    state: Literal["running", "finished", "stopped", "unreadable"] = "unreadable"
    """A `stopped` run can be resumed; settings or checkpoint of an `unreadable` one cannot be read."""
    problem: str | None = None
    """Why the run is unreadable."""


_FACTS = ("env", "algorithm", "preset", "seed", "generations")


def run_state(folder: RunFolder) -> RunState:
    """Return the state of the run in `folder`."""
    name = "last" if folder.checkpoint_path("last").is_file() else "best"  # a shipped agent has only the best
    try:
        config, checkpoint = folder.read_config(), folder.load(name, with_state=False)
    except ShesError as error:
        told: dict[str, Any] = {}
        faults = (ShesError, KeyError, TypeError, AttributeError, ValueError, OverflowError)
        with suppress(*faults):
            told = {each: folder.read_record()["config"]["run"].get(each) for each in _FACTS}
        with suppress(*faults):  # by its tables
            progress = read_csv(folder.progress)
            told |= {each: int(progress[each][-1]) for each in ("generation", "env_steps")}
            told["best_score"] = max(read_csv(folder.evaluation)["score_mean"])
        return RunState(run=str(folder.path), **told, problem=str(error))
    is_over = config.run.is_over(checkpoint.generation, checkpoint.env_steps) or name == "best"
    return RunState(
        run=str(folder.path),
        **{each: getattr(config.run, each) for each in _FACTS},
        generation=checkpoint.generation,
        env_steps=checkpoint.env_steps,
        best_score=checkpoint.best.score if checkpoint.best.generation >= 0 else None,
        state="running" if folder.is_locked() else "finished" if is_over else "stopped",
    )


def list_runs(folder: Path | str = "runs") -> Listing:
    """List the runs below a folder, and the shipped agents. The name of an agent can be given instead of a run.

    Args:
        folder: The folder.
    """
    runs = [run_state(each) for each in RunFolder.below(Path(folder))]
    agents = {name: read_agent(name) for name in shipped_names()}
    parts: list[Table | str] = [f"There is no run below {folder}."]
    if runs:
        cells = [
            (
                run.run,
                str(run.env or "-"),
                " / ".join("-" if each is None else str(each) for each in (run.generation, run.generations)),
                "-" if run.best_score is None else f"{run.best_score:.2f}",
                run.state,
            )
            for run in runs
        ]
        parts = [Table(("run", "environment", "generation", "best score", "state"), cells)]
    parts += [f"{run.run} is unreadable: {run.problem}" for run in runs if run.problem is not None]
    if agents:
        rows = list[tuple[str, ...]]()
        for name, agent in agents.items():
            scores = ("-" if found is None else found.score for found in agent.evaluations)
            rows.append((name, agent.env, *scores, f"{agent.env_steps / 1e6:.1f}"))
        parts += [
            Table(("agent", "environment", "score", "constant", "random", "steps"), rows),
            "Score: mean and standard error over fresh episodes. Steps: environment steps of training, in millions.",
            "Constant, random: score with the best constant controller, and with random goals, on the same episodes.",
            *(f"{name} {agent.description.rstrip('.')}." for name, agent in agents.items()),
        ]
    shown = {name: asdict(agent) for name, agent in agents.items()}
    return Listing({"runs": [asdict(run) for run in runs], "agents": shown}, parts)


def describe_run(run: Path | str, *, full: bool = False, card: bool = False) -> Listing:
    """Show the state of a run, and with --full its settings; of a shipped agent its result and how it was trained.

    Args:
        run: The run folder, or the name of a shipped agent.
        full: Show all settings. JSON always has them.
        card: Show a model card for the Hugging Face hub instead; scores are evaluated.
    """
    folder = RunFolder.open(run)
    if card:
        text = model_card(folder)
        return Listing({"card": text}, [text])
    record, config = folder.read_record(), folder.read_config()
    levels, name = ", ".join(config.level_names), shipped_name(folder.path)
    parts: list[Table | str] = []
    if name is None:
        state = asdict(run_state(folder))
        facts = {
            **{each: value for each, value in state.items() if each != "problem" or value is not None},
            **({"robot": config.numbers()["robot"]} if "robot" in config.values else {}),
            "levels": levels,
            "started": record.get("started"),
            "command": " ".join(map(str, record.get("command", []))).replace("__main__.py ", "shes "),
        }
        shown = facts
    else:
        agent = read_agent(name)
        facts = {"agent": name, "algorithm": config.run.algorithm, "levels": levels, **asdict(agent)}
        shown = {each: facts[each] for each in ("agent", "env", "algorithm", "levels", "env_steps", "hours", "cores")}
        shown["score"] = f"{agent.evaluation.score} over {agent.evaluation.episodes} fresh episodes"
        shown |= {f"score, {each.controller}": each.score for each in agent.evaluations[1:] if each is not None}
        parts = [f"It {agent.description.rstrip('.')}. Trained by:", *agent.commands]
    settings = {each: value for section in config.to_dict().values() for each, value in section.items()} if full else {}
    listing = facts_listing({**shown, **settings})
    return Listing({**facts, "config": record["config"]}, [*listing.parts, *parts])
