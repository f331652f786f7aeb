"""The commands `train` and `resume`, which are more than a function of the library: they take several runs."""

from __future__ import annotations

from typing import Annotated, Any

import tyro

from shes.errors import ConfigError
from shes.runs import train as run_training
from shes.runs.folder import checked_out, new_folder
from shes.runs.runs_folder import RunsFolder, read_sweep, vary
from shes.runs.train import Run
from shes.types import Listing


def train(
    env: Annotated[str, tyro.conf.arg(metavar="[ENV]", help_behavior_hint="")] = "",
    *,
    settings: dict[str, Any],
    like: Annotated[str | None, tyro.conf.arg(metavar="RUN", help_behavior_hint="")] = None,
    seed: Annotated[tuple[int, ...], tyro.conf.arg(metavar="INT ...")] = (1,),
    out: str | None = None,
    sweep: Annotated[
        tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=X,Y ...")
    ] = (),
) -> Run | Listing:
    """Train on an environment. Ctrl-C stops the run; shes resume continues it.

    Several seeds or sweep values train one run each.

    shes train point-gather --generations 60 --out runs/first

    Args:
        env: Environment (`shes envs`) or `gymnasium:ID`.
        like: Run whose environment and settings are the defaults.
        seed: Seed; each of several becomes a run.
        out: The run folder; if none, below runs/.
        sweep: A run for each value: sigma=0.02,0.05.
    """
    preset = settings.pop("preset", None)
    settings["like"] = like
    swept = read_sweep(text for texts in sweep for text in texts)
    if len(seed) == 1 and not swept:
        return run_training.train(env or None, preset=preset, out=out, progress=True, **{**settings, "seed": seed[0]})
    configs = vary(env, preset, settings, seed, swept)
    first = next(iter(configs.values()))
    place = new_folder(first, f"{len(configs)}-runs") if out is None else checked_out(out)
    return RunsFolder.create(place, configs).train_shown(list(configs))


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
        raise ConfigError(f"all {len(folder.configs)} runs of {run} have ended. To go on: {folder.how_to_go_on}")
    return folder.train_shown(list(folder.configs))
