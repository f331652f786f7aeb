"""The runs of an experiment, which can be stopped anywhere: finished ones are kept, unfinished ones go on.

Every run is an ordinary run folder below that of the experiment. An experiment that was stopped has the same numbers
as one that was not.
"""

from __future__ import annotations

import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from functools import partial
from multiprocessing import active_children, get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from experiments.design import ALONE, Experiment, Run
from experiments.results import read_results, read_summary, write_summary, write_tables
from experiments.summary import summarise
from shes.backends.named_backends import BACKENDS
from shes.errors import RunFolderError, ShesError, WorkerError
from shes.machine import core_numbers
from shes.runs.comparison import check_scipy
from shes.runs.config import TrainConfig, WorkerSettings
from shes.runs.folder import RunFolder, differing
from shes.runs.progress_display import format_duration
from shes.runs.train import finish_run
from shes.storage import storage_errors


def run_experiment(
    experiment: Experiment, out: Path, *, say: Callable[[str], None], num_workers: int = 0, backend: str = "processes"
) -> dict[str, str]:
    """Make the unfinished runs of `experiment`, and the tables after each; return the errors of those that failed.

    Args:
        experiment: The runs.
        out: Folder of the experiment.
        say: Receives lines about the progress.
        num_workers: Runs that are made at a time, or the workers of each large run; 0 is one for every core.
        backend: Backend of large runs.
    """
    check_experiment(experiment, out, backend)
    workers = {"backend": backend, "num_workers": num_workers} if experiment.has_large_runs else dict(ALONE)
    one = partial(finish, out=out, episodes=experiment.episodes, workers=workers)
    at_once = 0 if experiment.has_large_runs else WorkerSettings(num_workers=num_workers).count
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    failed: dict[str, str] = {}
    with RunFolder(out).lock():
        left = {run.name for run in runs_left(experiment, out)}
        say(f"{len(left)} of {len(experiment.runs)} runs are left. Ctrl-C stops, the same command continues.")
        ended, start = 0, monotonic()
        for stage in experiment.stages():
            ready = [run for run in stage if run.name in left]
            orphans = [run for run in ready if run.primitive is not None and run.primitive.name in failed]
            failed |= {run.name: "the run of its primitive failed" for run in orphans}
            ready = [run for run in ready if run.name not in failed]
            with closing(side_by_side(one, at_once, ready)) as outcomes:
                for run, error in outcomes:
                    ended += 1
                    rest = format_duration((monotonic() - start) / ended * (len(left) - ended))
                    say(f"[{ended}/{len(left)}] {run.name}: {'FAILED' if error else 'done'}; {rest} left")
                    if error:
                        failed[run.name] = error
                    else:
                        write_tables(experiment, read_results(experiment, out), out)
    return failed


def runs_left(experiment: Experiment, out: Path) -> list[Run]:
    """Return the runs still to be made, in order, with primitives whose folder is needed but no longer exists."""
    done = set(read_results(experiment, out))
    for run in reversed(experiment.ordered()):  # a run comes after its primitive
        if run.primitive is not None and run.name not in done and read_summary(run.primitive, out) is None:
            done.discard(run.primitive.name)
    return [run for run in experiment.ordered() if run.name not in done]


def check_experiment(experiment: Experiment, out: Path, backend: str = "processes") -> None:
    """Check packages, settings and folders before hours of runs; see `run_experiment`."""
    check_scipy()
    BACKENDS.find(backend)
    RunFolder(out).check_free()
    algorithms = {}
    for run in experiment.runs:
        folder = RunFolder(out / run.name)
        is_ready = run.primitive is None or RunFolder(out / run.primitive.name).config.is_file()
        config = run.config(out) if is_ready else run.planned_config()
        algorithms[config.run.algorithm] = config.algorithm
        if is_ready and folder.config.is_file():
            _check_settings(run, folder, config)
    for name, algorithm in algorithms.items():
        algorithm.check_installed(name)


def _check_settings(run: Run, folder: RunFolder, config: TrainConfig) -> None:
    """Raise RunFolderError unless a run folder has the settings of its run."""
    # The path of the primitive is not compared: the same folder may have another path.
    there, wanted = (
        {**each.numbers(), "generations": each.run.generations, "env_steps": each.run.env_steps, "primitive": None}
        for each in (folder.read_config(), config)
    )
    if others := differing(there, wanted):
        raise RunFolderError(
            f"{folder.path} holds a run of other settings than {run.name}, such as another --scale: {others}. "
            "Choose another folder with --out, or remove this one to have it made anew."
        )


def finish(run: Run, out: Path, episodes: int, workers: Mapping[str, Any] = ALONE) -> None:
    """Train a run to its end, from its last checkpoint if it has one; evaluate it and write its summary."""
    if read_summary(run, out) is not None:
        return
    config, folder = run.config(out, workers), RunFolder(out / run.name)
    if folder.config.is_file():
        _check_settings(run, folder, config)
    finish_run(config, folder.path)
    write_summary(run, out, summarise(run, out, episodes))


def _error(finish_one: Callable[[Run], None], run: Run) -> str:
    """Finish a run; return its error, empty if there is none. No error may stop the other runs."""
    try:
        finish_one(run)
    except ShesError as error:
        return str(error)
    except Exception:  # noqa: BLE001 - see above
        return traceback.format_exc()
    return ""


# Side by side. A run is as good after a kill as before, so processes that are no longer needed are killed.


def side_by_side(finish_one: Callable[[Run], None], at_once: int, runs: Sequence[Run]) -> Generator[tuple[Run, str]]:
    """Yield each run and its error when it has ended; `at_once` processes make them, or this one if it is 0."""
    if not at_once or not runs:
        yield from ((run, _error(finish_one, run)) for run in runs)
        return
    context, cores, before = get_context("spawn"), core_numbers(), active_children()
    places = context.SimpleQueue()
    for number in range(at_once):
        # With fewer processes than cores, another experiment may use the rest, and must not meet this one on a core.
        places.put(cores[number % len(cores)] if at_once >= len(cores) else None)
    pool = ProcessPoolExecutor(min(at_once, len(runs)), context, _begin_worker, (places, os.getpid()))
    try:
        runs_of = {pool.submit(_error, finish_one, run): run for run in runs}
        for future in as_completed(runs_of):
            yield runs_of[future], future.result()
    except BrokenProcessPool as error:
        raise WorkerError(
            "a process that made runs has died, maybe for lack of memory. The same command goes on."
        ) from error
    finally:
        for process in active_children():
            if process not in before:
                process.kill()
        pool.shutdown(cancel_futures=True)


def _begin_worker(places: SimpleQueue[int | None], parent: int) -> None:
    """Keep this process to a core of `places`, and end it with its parent, which alone handles Ctrl-C.

    A library may use all cores that are idle, as JAX does for HIRO: the last runs of an experiment would then be faster
    than those before.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if (core := places.get()) is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})

    def watch() -> None:
        while os.getppid() == parent:
            sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
