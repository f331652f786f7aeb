"""`shes.train` and `shes.resume`: those of `shes.training`, with live progress in a terminal or a notebook."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console

from shes.cli.progress_display import ProgressDisplay
from shes.training import train as training
from shes.training.listening import AnyListener
from shes.training.train import Run

__all__ = ["resume", "train"]


def train(
    env: str,
    *,
    preset: str = "laptop",
    out: Path | str | None = None,
    listener: AnyListener = None,
    progress: bool | None = None,
    **settings: Any,
) -> Run:
    """Train on `env` and return the run.

    Args:
        env: Environment, e.g. `ant-gather`.
        preset: `paper`, `laptop` or `smoke`.
        out: The run folder, which must not hold a run; a new one below `runs/` if none.
        listener: Receives the progress: a function of a row of `progress.csv`, an object with any of the methods
            `on_start`, `on_generation`, `on_evaluation` and `on_event`, or a list of these. It ends the run by
            returning True or raising `shes.StopTraining`.
        progress: Whether to show the progress; only in a terminal or a notebook if None.
        settings: Any setting by name, e.g. `seed=0, num_workers=4`.

    Raises:
        UnknownNameError: The environment, the preset or another name is unknown.
        ConfigError: A setting is unknown or out of range, the run does not fit this machine, or `listener` cannot be
            called.
        RunFolderError: `out` already holds a run.
        StorageError: A file cannot be written.
        WorkerError: A worker failed, or workers keep dying.
        PolicyError: A policy returned NaN.
        DivergenceError: Every episode of `max_diverged_generations` generations in a row diverged.
    """
    with ExitStack() as stack:
        return training.train(env, preset=preset, out=out, listener=_shown(stack, listener, progress), **settings)


def resume(path: Path | str, *, listener: AnyListener = None, progress: bool | None = None, **settings: Any) -> Run:
    """Continue the run at `path` from its last checkpoint, as if it had never stopped.

    Args:
        path: The run folder.
        listener: Receives the progress, as in `train`.
        progress: Whether to show the progress; only in a terminal or a notebook if None.
        settings: Execution settings, e.g. `generations=2000, num_workers=8, device="cuda"`.

    Raises:
        RunFolderError: `path` is not a run folder, or belongs to a shipped agent.
        CheckpointError: The last checkpoint is damaged or from another run.
        ConfigError: A setting would change the run's numbers, the run is finished, or the machine has no such device.
        MissingExtraError: The device needs a package that is not installed.
    """
    with ExitStack() as stack:
        return training.resume(path, listener=_shown(stack, listener, progress), **settings)


def _shown(stack: ExitStack, listener: AnyListener, progress: bool | None) -> AnyListener:
    """Return `listener` beside a progress display that is on until `stack` ends, if progress is to be shown."""
    console = Console()
    if not (console.is_terminal or console.is_jupyter if progress is None else progress):
        return listener
    display = stack.enter_context(ProgressDisplay(console))
    return [display, *(listener if isinstance(listener, list | tuple) else () if listener is None else (listener,))]
