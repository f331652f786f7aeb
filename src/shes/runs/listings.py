"""The listings of `shes list` and `shes info`: the state of runs, what is shipped, and the model card of a run."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from shes.errors import RunFolderError, ShesError
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.shipped import FreshScore, read_agent, shipped_name, shipped_names
from shes.types import Listing, Table, facts_listing

CARD_EPISODES = 100
"""Fresh episodes on which the controllers of a run are evaluated."""
_VIDEO = "replay.mp4"  # in the run folder, which the hub shows
_CARD = """---
library_name: shes
pipeline_tag: reinforcement-learning
tags: [reinforcement-learning, evolution-strategies, mujoco, {env}]
model-index:
- name: {name}
  results:
  - task: {{type: reinforcement-learning, name: reinforcement-learning}}
    dataset: {{name: {env}, type: {env}}}
    metrics: [{{type: mean_reward, name: score, value: {score}}}]
---

# {title}

A policy for `{run_env}`, trained by `{algorithm}` of SHES ({levels}).

| controller | score ± standard error | success |
|---|---|---|
{rows}

Scores are means over {episodes} fresh episodes. What a constant or a random controller reaches as well was not learned.

- seed {seed}, {env_steps:,} environment steps, {generation} generations
- trained by `{command}`
{video}
```
pip install shes
shes evaluate FOLDER
shes render FOLDER --out replay.mp4
```
"""


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The state of a run. All but its folder and the problem are None if it is unreadable."""

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


def run_state(folder: RunFolder) -> RunState:
    """Return the state of the run in `folder`."""
    name = "last" if folder.checkpoint_path("last").is_file() else "best"  # a shipped agent has only the best
    try:
        config, checkpoint = folder.read_config(), folder.load(name, with_state=False)
    except ShesError as error:
        return RunState(run=str(folder.path), problem=str(error))
    is_over = config.run.is_over(checkpoint.generation, checkpoint.env_steps) or name == "best"
    return RunState(
        run=str(folder.path),
        **{each: getattr(config.run, each) for each in ("env", "algorithm", "preset", "seed", "generations")},
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
    if not Path(folder).is_dir() and str(folder) != "runs":
        raise RunFolderError(f"{folder} is not a folder. Give one with runs below it, or none for those below runs/.")
    runs = [run_state(each) for each in RunFolder.below(Path(folder))]
    agents = {name: read_agent(name) for name in shipped_names()}
    parts: list[Table | str] = [] if runs else [f"There is no run below {folder}."]
    cells = list[tuple[str, ...]]()
    for run in runs:
        score = "-" if run.best_score is None else f"{run.best_score:.2f}"
        if run.problem is None:
            cells.append((run.run, str(run.env), f"{run.generation} / {run.generations}", score, run.state))
        else:
            parts.append(f"{run.run} is unreadable: {run.problem}")
    if cells:
        parts.insert(0, Table(("run", "environment", "generation", "best score", "state"), cells))
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
        text = _model_card(folder)
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
            "command": " ".join(map(str, record.get("command", []))),
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


def _model_card(folder: RunFolder) -> str:
    """Evaluate all controllers of a run's best checkpoint; return its card for the Hugging Face hub, in Markdown."""
    config, checkpoint, name = folder.read_config(), folder.load("best", with_state=False), shipped_name(folder.path)
    agent = None if name is None else read_agent(name)
    if agent is None:
        asked = ("trained", "constant", "random") if "controller" in config.level_names else ("trained",)
        found = (evaluate(folder.path, episodes=CARD_EPISODES, controller=each) for each in asked)
        scores = [FreshScore.of(each.listing().facts) for each in found]
    else:
        scores = [each for each in agent.evaluations if each]
    command = shlex.join(map(str, folder.read_record().get("command", []))) if agent is None else agent.commands[-1]
    rows = [f"| {each.controller or 'none'} | {each.score} | {100 * each.success_rate:.0f} % |" for each in scores]
    title = folder.path.resolve().name
    quoted = {"name": title, "env": config.run.env, "score": scores[0].score}
    return _CARD.format(
        **{name: json.dumps(value, ensure_ascii=False) for name, value in quoted.items()},
        title=title,
        run_env=config.run.env,
        algorithm=config.run.algorithm,
        levels=", ".join(config.level_names),
        rows="\n".join(rows),
        episodes=scores[0].episodes,
        seed=config.run.seed,
        env_steps=checkpoint.env_steps if agent is None else agent.env_steps,
        generation=checkpoint.generation if agent is None else agent.generation,
        command=command,
        video=f"\n<video controls src={_VIDEO}></video>\n" if (folder.path / _VIDEO).exists() else "",
    )
