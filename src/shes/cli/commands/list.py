"""`shes list`: the shipped agents."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from shes.cli.command import Command
from shes.cli.options import Group, options_of
from shes.cli.output import print_line, print_table


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes list` takes."""

    json: bool = False
    """Print one JSON object: what is told of each agent, by name."""


def _run(values: dict[str, Any]) -> int:
    from shes.runs.shipped import read_agent, shipped_names

    agents = {name: read_agent(name) for name in shipped_names()}
    if Arguments(**values).json:
        print(json.dumps({name: agent.to_dict() for name, agent in agents.items()}))
        return 0
    if not agents:
        print_line("This version of SHES ships no agent.")
        return 0
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
    print_line(
        "Score: mean and standard deviation over fresh episodes. Steps: environment steps of its training. A name "
        "stands wherever a run folder may: shes evaluate NAME. More: --json."
    )
    return 0


COMMAND = Command(
    name="list",
    description=(
        "List the shipped agents: trained ones that are part of the package. A name stands wherever a run folder may."
    ),
    examples=("shes list --json",),
    groups=(Group(heading="flags", options=options_of(Arguments)),),
    run=_run,
)
