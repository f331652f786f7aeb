"""The commands that are more than a function of the library: `train` and `resume`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import tyro

from shes.errors import ConfigError
from shes.listing import Listing
from shes.runs.folder import new_folder
from shes.training import train as run_training
from shes.training.runs_folder import RunsFolder
from shes.training.train import Run
from shes.training.variations import read_sweep, vary


def train(
    env: str,
    settings: dict[str, Any],
    *,
    seed: tuple[int, ...] = (1,),
    out: Path | None = None,
    sweep: Annotated[
        tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE,VALUE ...")
    ] = (),
) -> Run | Listing:
    """Train on an environment. Ctrl-C stops and loses nothing, and shes resume continues.

    Several seeds or a sweep make a folder of runs. The same command, or shes resume, goes on with those that are left.

    shes train point-gather --generations 60 --out runs/first

    Args:
        env: Environment name (see `shes envs`) or `gymnasium:ID`.
        seed: Seed; each of several becomes a run.
        out: The run folder; a new one below runs/ if none.
        sweep: Values of a setting, each of which becomes a run: sigma=0.02,0.05.
    """
    preset = settings.pop("preset", "laptop")
    swept = read_sweep(text for texts in sweep for text in texts)
    if not seed:
        raise ConfigError("seed needs at least one value. Set --seed 1 2 3, or omit it.")
    if len(seed) == 1 and not swept:
        return run_training.train(env, preset=preset, out=out, progress=True, **{**settings, "seed": seed[0]})
    configs = vary(env, preset, settings, seed, swept)
    folder = RunsFolder.create(out or new_folder(next(iter(configs.values())), f"{len(configs)}-runs"), configs)
    return folder.train_shown(list(configs))


def resume(run: str, settings: dict[str, Any]) -> Run | Listing:
    """Continue a run, or a folder of runs, as if it had never stopped.

    shes resume runs/first --generations 200 --workers 4

    Args:
        run: The run folder.
    """
    if not RunsFolder.is_at(run):
        return run_training.resume(run, progress=True, **settings)
    folder = RunsFolder.open(run, **settings)
    if not folder.left:
        raise ConfigError(
            f"all {len(folder.configs)} runs of {run} have ended. To go on: shes resume {quote(run)} "
            f"--generations {2 * max(config.run.generations for config in folder.configs.values())}"
        )
    return folder.train_shown(list(folder.configs))
