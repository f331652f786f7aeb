"""`shes bench`: how fast this machine is."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import tyro

from shes.bench.measure import bench_rollout, bench_update
from shes.cli.output import print_facts
from shes.cli.parsing import DEFAULT_ENV
from shes.errors import ConfigError
from shes.training.presets import make_config


def bench(
    name: Annotated[Literal["rollout", "update"], tyro.conf.Positional],
    settings: dict[str, Any],
    env: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ENV")] = DEFAULT_ENV,
    *,
    seconds: float = 0.0,
    json: bool = False,
) -> int:
    """Measure how fast this machine is, with the settings of shes train.

    shes bench rollout --seconds 60

    Args:
        name: rollout: steps per second of whole generations against a bare mj_step loop on the same episodes; update:
            milliseconds of the parent's work between generations, by part.
        settings: Settings by name.
        env: Environment, see shes envs.
        seconds: Measure for so long at least: on a machine shared with others the median of many turns is steadier.
        json: Print one JSON object.
    """
    if not 0 <= seconds < float("inf"):
        raise ConfigError(f"seconds must be zero or a positive number, got {seconds}. Set --seconds.")
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    benches = {"rollout": bench_rollout, "update": bench_update}
    print_facts(benches[name](config, seconds=seconds), as_json=json)
    return 0
