"""The model card of a run, as the Hugging Face hub shows it: scores, seed, steps, command and a video."""

from __future__ import annotations

import json
import shlex

from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.shipped import FreshScore, read_agent, shipped_name

EPISODES = 100
"""Fresh episodes on which the controllers of a run are evaluated."""
VIDEO = "replay.mp4"
"""Video in the run folder that the hub shows."""
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


def model_card(folder: RunFolder) -> str:
    """Return the card of the best checkpoint of a run, in Markdown. All controllers are evaluated for it."""
    config, checkpoint, name = folder.read_config(), folder.load("best", with_state=False), shipped_name(folder.path)
    agent = None if name is None else read_agent(name)
    if agent is None:
        asked = ("trained", "constant", "random") if "controller" in config.level_names else ("trained",)
        found = (evaluate(folder.path, episodes=EPISODES, controller=each) for each in asked)
        scores = [FreshScore.of(each.listing().facts) for each in found]
    else:
        scores = [each for each in agent.evaluations if each]
    command = shlex.join(map(str, folder.read_record().get("command", []))) if agent is None else agent.commands[-1]
    rows = [f"| {each.controller or 'none'} | {each.score} | {100 * each.success_rate:.0f} % |" for each in scores]
    title = folder.path.resolve().name
    return _CARD.format(
        name=_text(title),
        env=_text(config.run.env),
        score=_text(scores[0].score),
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
        video=f"\n<video controls src={VIDEO}></video>\n" if (folder.path / VIDEO).exists() else "",
    )


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
