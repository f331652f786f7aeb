"""`shes train`, `resume`, `evaluate` and `bench`: everything that steps environments by the thousand."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

import shes
from shes.cli.output import make_console, print_error, print_facts, print_line, quote
from shes.cli.parsing import DEFAULT_ENV, Env, Json, Run
from shes.cli.progress_display import ProgressDisplay
from shes.errors import ConfigError
from shes.runs.folder import RunFolder, new_folder
from shes.training.presets import make_config
from shes.training.runs_folder import RunsFolder
from shes.training.train import Run as FinishedRun
from shes.training.train import resume as resume_run
from shes.training.train import start_run
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
        return _show_progress(lambda display: start_run(config, out, display), out)
    configs = vary(env, preset, settings, seed, swept)
    folder = RunsFolder.create(out or new_folder(next(iter(configs.values())), f"{len(configs)}-runs"), configs)
    return _train_all(folder, list(configs))


def resume(run: Run, settings: dict[str, Any]) -> int:
    """Continue a run, or a folder of runs, as if it had never stopped.

    shes resume runs/first --generations 200 --workers 4
    """
    if RunsFolder.is_at(run):
        folder = RunsFolder.open(run, **settings)
        if not folder.left:
            raise ConfigError(
                f"all {len(folder.configs)} runs of {run} have ended. To go on: shes resume {quote(run)} "
                f"--generations {2 * max(config.run.generations for config in folder.configs.values())}"
            )
        return _train_all(folder, list(folder.configs))
    return _show_progress(lambda display: resume_run(run, listener=display, **settings), Path(run))


def _train_all(folder: RunsFolder, names: list[str]) -> int:
    """Train the runs `names` of a folder that have not ended; return the exit code."""
    displays, left, failed = ExitStack(), [name for name in names if name in folder.left], 0

    def display_of(name: str) -> ProgressDisplay:
        print_line(f"[{names.index(name) + 1}/{len(names)}] {name}")
        return displays.enter_context(ProgressDisplay(make_console()))

    try:
        with displays, closing(folder.train(left, display_of)) as outcomes:
            for ended in outcomes:
                displays.close()
                if ended.error is not None:
                    failed += 1
                    print_error(f"{ended.name} failed: {ended.error}")
    except KeyboardInterrupt:
        print_line(f"Stopped; all finished generations are kept. Go on: shes resume {quote(folder.path)}")
        raise
    found = quote(folder.path)
    if failed:
        print_error(f"{failed} of {len(names)} runs failed. To go on with them: shes resume {found}")
        return 1
    print_line(f"Done: {len(names)} runs, one in each folder below {found}.")
    print_line(f"Next: shes plot {found} · shes list {found} · shes evaluate {quote(folder.path / names[0])}")
    return 0


def _show_progress(work: Callable[[ProgressDisplay], FinishedRun], path: Path | None) -> int:
    """Call `work` with a progress display; after Ctrl-C, print how to resume the run.

    Args:
        work: Trains, and reports to the display.
        path: The run folder, if it is known before.
    """
    display = ProgressDisplay(make_console())
    try:
        with display:
            run = work(display)
    except KeyboardInterrupt:
        path = display.path or path
        # Before the first generation the display knows no path; the run can be resumed if its record exists.
        if path is not None and RunFolder(path).config.is_file():
            print_line(f"Stopped; all finished generations are kept. Go on: shes resume {quote(path)}")
        raise
    best = "no evaluation yet"
    if run.best.generation >= 0:
        best = f"best evaluation score {run.best.score:.2f} (generation {run.best.generation})"
    found = quote(run.path)
    print_line(f"Done: {run.generation} generations, {best}.")
    print_line(f"Next: shes evaluate {found} · shes render {found} · shes plot {found}")
    return 0


def evaluate(*, json: Json = False, **options: Annotated[Any, "shes.training.evaluate.evaluate"]) -> int:
    """Evaluate a checkpoint of a run on fresh episodes, without noise.

    shes evaluate runs/first --episodes 100
    """
    found = shes.evaluate(**options)
    facts = {"run": options["run"], "checkpoint": options["checkpoint"], **found.summary()}
    print_facts(facts, as_json=json)
    return 0


def bench(
    name: Literal["rollout", "update", "speedup"],
    settings: dict[str, Any],
    env: Annotated[Env, tyro.conf.Positional] = DEFAULT_ENV,
    *,
    seconds: float = 0.0,
    json: Json = False,
    out: Path = Path("speedup"),
    latency_us: float = 50.0,
    gigabits_per_s: float = 10.0,
) -> int:
    """Measure the speed of this machine, with the settings of shes train.

    shes bench rollout --seconds 60

    Args:
        name: rollout: steps per second of whole generations, against a bare mj_step loop on the same episodes; update:
            milliseconds of the parent's work between generations, by part; speedup: SHES and S-ES on 1 to --workers
            cores, and a projection to a cluster of 24 cores per node.
        seconds: Minimum duration of the measurement. On a shared machine a long one is more precise.
        out: Folder for the table and the figure of speedup.
        latency_us: Latency of the cluster's network, in microseconds.
        gigabits_per_s: Bandwidth of the cluster's network.
    """
    from shes.bench.measure import bench_rollout, bench_update

    if not 0 <= seconds < float("inf"):
        raise ConfigError(f"seconds must be zero or a positive number, got {seconds}. Set --seconds.")
    if name == "speedup":
        from shes.bench.speedup import speedup_of

        print_facts(speedup_of(env, settings, out, latency_us, gigabits_per_s, seconds), as_json=json)
        return 0
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    measure = bench_rollout if name == "rollout" else bench_update
    print_facts(measure(config, seconds=seconds), as_json=json)
    return 0
