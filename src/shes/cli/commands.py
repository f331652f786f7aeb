"""The commands that are more than a function of the library: `train`, `resume`, `bench` and `experiment`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import tyro

from shes.cli.output import show
from shes.cli.parsing import DEFAULT_ENV
from shes.console import LineConsole
from shes.errors import ConfigError
from shes.listing import Listing, facts_listing
from shes.runs.folder import new_folder
from shes.runs.rooms import WorkerSettings
from shes.studies.index import STUDIES
from shes.studies.perform import perform
from shes.training import train as run_training
from shes.training.presets import make_config
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
        env: Environment, see shes envs; or gymnasium:ID for one of Gymnasium.
        settings: Settings of the runs.
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
        settings: Settings that do not change the numbers of the run.
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


def bench(
    name: Literal["rollout", "update"],
    settings: dict[str, Any],
    env: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ENV")] = DEFAULT_ENV,
    *,
    seconds: float = 0.0,
) -> Listing:
    """Measure the speed of this machine, with the settings of shes train.

    shes bench rollout --seconds 60

    Args:
        name: rollout: steps per second of whole generations, against a bare mj_step loop on the same episodes; update:
            milliseconds of the parent's work between generations, by part.
        settings: Settings of the run.
        env: Environment, see shes envs.
        seconds: Minimum duration of the measurement. On a shared machine a long one is more precise.
    """
    from shes.bench.measure import bench_rollout, bench_update

    config = make_config(env, settings.pop("preset", "laptop"), settings)
    measure = bench_rollout if name == "rollout" else bench_update
    return facts_listing(measure(config, seconds=seconds))


def experiment(
    name: Literal["ablation", "learning"],
    *,
    out: Path | None = None,
    workers: int = 0,
    scale: Literal["laptop", "smoke"] = "laptop",
    seeds: int | None = None,
    only: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="GROUP [GROUP ...]")] = None,
    json: bool = False,
) -> int:
    """Run a study of many runs and draw its figures. The same command continues a study that was stopped.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the paper's choices, a sweep of the settings, transfer and horizon, on Point Gather and Maze;
            learning: the worth of each part of the walker's learning, on Ant Flagrun.
        out: Folder of its runs, tables and figures; finished runs in it are kept. runs/ and its name if none.
        workers: Runs at a time; 0 is one for every core.
        scale: laptop: hours on two cores; smoke: a minute, as a test.
        seeds: Seeds of every variant; if none 10, and 5 in a sweep and in learning (smoke: 2).
        only: Groups to run beside the base; all if none. ablation: choices, horizon, sweep, transfer; learning:
            alternatives, form, pieces, sweep.
        json: Print JSON.
    """
    out, count = out or Path("runs") / name, WorkerSettings(num_workers=workers).count
    say = (lambda _: None) if json else LineConsole().line
    return show(perform(STUDIES[name](scale, seeds), out, only, count, say), as_json=json)
