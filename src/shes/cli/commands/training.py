"""`shes train`, `resume`, `evaluate` and `bench`: everything that steps environments by the thousand."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import tyro

import shes
from shes.cli.output import make_console, print_line, show
from shes.cli.parsing import DEFAULT_ENV, Env, Json, Run
from shes.errors import ConfigError
from shes.listing import facts_listing
from shes.runs.folder import new_folder
from shes.training.presets import make_config
from shes.training.progress_display import ProgressDisplay
from shes.training.runs_folder import RunsFolder
from shes.training.train import resume_run, start_run
from shes.training.variations import read_sweep, vary


def train(
    env: Env,
    settings: dict[str, Any],
    *,
    seed: tuple[int, ...] = (1,),
    out: Path | None = None,
    sweep: Annotated[
        tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE,VALUE ...")
    ] = (),
) -> int:
    """Train on an environment. Ctrl-C stops and loses nothing, and shes resume continues.

    Several seeds or a sweep make a folder of runs. The same command, or shes resume, goes on with those that are left.

    shes train point-gather --generations 60 --out runs/first

    Args:
        seed: Seed; each of several becomes a run.
        out: The run folder; a new one below runs/ if none.
        sweep: Values of a setting, each of which becomes a run: sigma=0.02,0.05.
    """
    preset = settings.pop("preset", "laptop")
    swept = read_sweep(text for texts in sweep for text in texts)
    if not seed:
        raise ConfigError("seed needs at least one value. Set --seed 1 2 3, or omit it.")
    if len(seed) == 1 and not swept:
        config = make_config(env, preset, {**settings, "seed": seed[0]})
        with ProgressDisplay(make_console()) as display:
            run = start_run(config, out, display)
        return show(run.listing())
    configs = vary(env, preset, settings, seed, swept)
    folder = RunsFolder.create(out or new_folder(next(iter(configs.values())), f"{len(configs)}-runs"), configs)
    return _train_all(folder, configs)


def resume(run: Run, settings: dict[str, Any]) -> int:
    """Continue a run, or a folder of runs, as if it had never stopped.

    shes resume runs/first --generations 200 --workers 4
    """
    if not RunsFolder.is_at(run):
        with ProgressDisplay(make_console()) as display:
            resumed = resume_run(run, display, **settings)
        return show(resumed.listing())
    folder = RunsFolder.open(run, **settings)
    if not folder.left:
        raise ConfigError(
            f"all {len(folder.configs)} runs of {run} have ended. To go on: shes resume {quote(run)} "
            f"--generations {2 * max(config.run.generations for config in folder.configs.values())}"
        )
    return _train_all(folder, folder.configs)


def _train_all(folder: RunsFolder, names: Iterable[str]) -> int:
    """Train the runs `names` of a folder that have not ended; return the exit code."""
    return show(folder.train_shown(list(names), lambda: ProgressDisplay(make_console()), print_line))


def evaluate(*, json: Json = False, **options: Annotated[Any, "shes.training.evaluate.evaluate"]) -> int:
    """Evaluate a checkpoint of a run on fresh episodes, without noise.

    shes evaluate runs/first --episodes 100
    """
    facts = shes.evaluate(**options).summary()
    return show(facts_listing({"run": options["run"], "checkpoint": options["checkpoint"], **facts}), json)


def bench(
    name: Literal["rollout", "update"],
    settings: dict[str, Any],
    env: Annotated[Env, tyro.conf.Positional] = DEFAULT_ENV,
    *,
    seconds: float = 0.0,
    json: Json = False,
) -> int:
    """Measure the speed of this machine, with the settings of shes train.

    shes bench rollout --seconds 60

    Args:
        name: rollout: steps per second of whole generations, against a bare mj_step loop on the same episodes; update:
            milliseconds of the parent's work between generations, by part.
        seconds: Minimum duration of the measurement. On a shared machine a long one is more precise.
    """
    from shes.bench.measure import bench_rollout, bench_update

    config = make_config(env, settings.pop("preset", "laptop"), settings)
    measure = bench_rollout if name == "rollout" else bench_update
    return show(facts_listing(measure(config, seconds=seconds)), json)
