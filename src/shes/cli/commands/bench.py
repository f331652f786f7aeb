"""`shes bench`: how fast this machine is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of
from shes.cli.output import print_facts

_NAMES = ("rollout", "update")


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes bench` takes beside the settings."""

    bench: Annotated[str, Shown(choices=_NAMES, noun="the name of a bench")]
    """rollout: steps per second of whole generations against a bare mj_step loop on the same episodes and branches.
    update: milliseconds of the parent's work between generations, by part."""
    seconds: float = 0.0
    """Measure for so long at least: on a machine shared with others the median of many turns is steadier."""
    json: bool = False
    """Print one JSON object."""


def _groups(words: Sequence[str]) -> tuple[Group, ...]:
    from shes.cli.settings import asked_config, environment_group, setting_groups

    config = asked_config(words)
    settings = setting_groups(config)
    name, seconds, json = options_of(Arguments)
    where = environment_group(is_required=False).options
    return (Group(heading="what to measure", options=(name, *where, seconds, json)), *settings)


def _run(values: dict[str, Any]) -> int:
    from shes.bench.measure import bench_rollout, bench_update
    from shes.cli.settings import DEFAULT_ENV, make_asked_config
    from shes.errors import ConfigError, UnknownNameError

    benches = {"rollout": bench_rollout, "update": bench_update}
    name, seconds, as_json = values.pop("bench"), values.pop("seconds", 0.0), values.pop("json", False)
    if name not in benches:
        raise UnknownNameError("bench", name, benches, "`shes bench --help` explains them.")
    if not 0 <= seconds < float("inf"):
        raise ConfigError(f"seconds must be zero or a positive number, got {seconds}. Set --seconds.")
    config = make_asked_config({"env": DEFAULT_ENV, **values})
    print_facts(benches[name](config, seconds=seconds), as_json=as_json)
    return 0


COMMAND = Command(
    name="bench",
    description="Measure how fast this machine is, with the settings of shes train.",
    examples=("shes bench rollout --seconds 60", "shes bench update point-gather --population-size 1000"),
    groups=_groups,
    run=_run,
    is_help_alone=True,
)
