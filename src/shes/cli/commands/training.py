"""`shes train`, `resume`, `evaluate` and `bench`: everything that steps environments by the thousand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from shes.cli.output import make_console, print_facts, print_line, quote
from shes.cli.parsing import DEFAULT_ENV, Checkpoint, Env, ExecutionFlags, Json, Run
from shes.cli.progress_display import ProgressDisplay
from shes.errors import ConfigError
from shes.runs.folder import RunFolder
from shes.training.evaluate import evaluate as run_episodes
from shes.training.presets import make_config
from shes.training.train import Run as FinishedRun
from shes.training.train import resume as resume_run
from shes.training.train import start_run


def train(env: Env, settings: dict[str, Any], *, out: Path | None = None) -> int:
    """Train on an environment, with live progress. Ctrl-C stops and loses nothing: shes resume continues the run.

    shes train point-gather --generations 60 --out runs/first

    Args:
        out: The run folder, which must not hold a run; a new one below runs/ if none.
    """
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    return _show_progress(lambda display: start_run(config, out, display), out)


def resume(run: Run, settings: ExecutionFlags) -> int:
    """Continue a run as if it had never stopped.

    shes resume runs/first --generations 200 --workers 4
    """
    return _show_progress(lambda display: resume_run(run, listener=display, **settings), Path(run))


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


def evaluate(
    run: Run,
    *,
    num_workers: Annotated[int, tyro.conf.arg(name="workers", aliases=("--num-workers",))] = 0,
    checkpoint: Checkpoint = "best",
    json: Json = False,
    **options: Annotated[Any, run_episodes],
) -> int:
    """Evaluate a checkpoint of a run on fresh episodes, without noise.

    shes evaluate runs/first --episodes 100
    """
    found = run_episodes(run, checkpoint=checkpoint, num_workers=num_workers, **options)
    print_facts({"run": run, "checkpoint": checkpoint, **found.summary()}, as_json=json)
    return 0


def bench(
    name: Annotated[Literal["rollout", "update"], tyro.conf.Positional],
    settings: dict[str, Any],
    env: Env = DEFAULT_ENV,
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

    if not 0 <= seconds < float("inf"):
        raise ConfigError(f"seconds must be zero or a positive number, got {seconds}. Set --seconds.")
    config = make_config(env, settings.pop("preset", "laptop"), settings)
    measure = bench_rollout if name == "rollout" else bench_update
    print_facts(measure(config, seconds=seconds), as_json=json)
    return 0
