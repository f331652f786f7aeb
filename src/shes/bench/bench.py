"""`shes bench`: the speed of this machine, and of a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from shes.bench.measure import bench_rollout, bench_update
from shes.bench.speedup import speedup_of
from shes.checked import checked
from shes.listing import Listing, facts_listing
from shes.settings import Ge, Gt
from shes.training.make_config import make_config

_SPEEDUP_NOTE = (
    "Efficiencies: speed-up / cores. Errors: projected / measured time of a generation, minus 1. Project from "
    "generations that last seconds. Written: {out}/speedup.csv and speedup.png."
)


@checked
def bench(
    name: Literal["rollout", "update", "speedup"],
    settings: dict[str, Any],
    env: str = "ant-gather",
    *,
    seconds: Annotated[float, Ge(0)] = 0.0,
    out: Path = Path("speedup"),
    latency_us: Annotated[float, Ge(0)] = 50.0,
    gigabits_per_s: Annotated[float, Gt(0)] = 10.0,
) -> Listing:
    """Measure the speed of this machine, with the settings of shes train.

    shes bench rollout --seconds 60

    Args:
        name: rollout: steps per second of whole generations, against a bare mj_step loop on the same episodes; update:
            milliseconds of the parent's work between generations, by part; speedup: SHES and S-ES on 1 to --workers
            cores, and a projection to a cluster of 24 cores per node.
        settings: Settings of `shes.train` by name.
        env: Environment, see shes envs.
        seconds: Minimum duration of the measurement. On a shared machine a long one is more precise.
        out: Folder for the table and the figure of speedup.
        latency_us: Latency of the cluster's network, in microseconds.
        gigabits_per_s: Bandwidth of the cluster's network.

    Raises:
        ConfigError: An argument or a setting is out of range.
    """
    if name == "speedup":
        listing = facts_listing(speedup_of(env, settings, out, latency_us, gigabits_per_s, seconds))
        return listing._replace(parts=[*listing.parts, _SPEEDUP_NOTE.format(out=out)])
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    measure = bench_rollout if name == "rollout" else bench_update
    return facts_listing(measure(config, seconds=seconds))
