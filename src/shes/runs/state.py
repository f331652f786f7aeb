"""The state of runs: how far they are, and whether they can be resumed."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from shes.errors import CheckpointError, ConfigError, RunFolderError, ShesError, UnknownNameError
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.storage import can_lock


@dataclass(frozen=True, kw_only=True)
class RunState:
    """The state of a run."""

    run: str
    env: str | None
    algorithm: str | None
    preset: str | None
    seed: int | None
    generation: int | None
    """Number of finished generations."""
    generations: int | None
    """Number of generations after which it ends."""
    env_steps: int | None
    best_score: float | None
    """Score of the best evaluation; None before the first one."""
    state: Literal["running", "finished", "stopped", "damaged", "tables only", "unregistered", "unreadable"]
    """A `stopped` run can be resumed; a run with `tables only` has no checkpoints; an `unregistered` one needs a
    class that is not registered here. Unknown fields of the latter and of an `unreadable` run are None."""
    problem: str | None = None
    """Why the run is unreadable, or the name of the class that is not registered."""

    def to_dict(self) -> dict[str, Any]:
        """Return the state as JSON types."""
        return asdict(self)


def run_state(folder: RunFolder) -> RunState:
    """Return the state of the run in `folder`; for the errors see `RunFolder.read_config`."""
    config = folder.read_config()
    generation, steps, score, is_over = 0, 0, None, False
    name = "last" if folder.checkpoint_path("last").is_file() else "best"  # a shipped agent has only the best
    try:
        checkpoint = folder.load(name, with_state=False)
        generation, steps = checkpoint.generation, checkpoint.env_steps
        score = checkpoint.best.score if checkpoint.best.generation >= 0 else None
        is_over = config.run.is_over(generation, steps) or name == "best"
    except CheckpointError:
        state = "damaged" if folder.checkpoint_path(name).is_file() else "tables only"
    else:
        state = "running" if _is_locked(folder) else "finished" if is_over else "stopped"
    return RunState(
        run=str(folder.path),
        env=config.run.env,
        algorithm=config.run.algorithm,
        preset=config.run.preset,
        seed=config.run.seed,
        generation=generation,
        generations=config.run.generations,
        env_steps=steps,
        best_score=score,
        state=state,
    )


def unregistered_state(folder: RunFolder) -> RunState | None:
    """Return the state of a run by its tables if it needs a class that is not registered here, else None."""
    try:
        folder.read_config()
    except ConfigError as error:
        if isinstance(error.__cause__, UnknownNameError):
            return _state_by_tables(folder, error)
    return None


def states_below(path: Path) -> list[RunState]:
    """Return the states of the runs below `path`, in natural order; runs that cannot be read say why."""
    found: list[RunState] = []
    for folder in RunFolder.below(path):
        try:
            found.append(run_state(folder))
        except Exception as error:  # noqa: BLE001 - one bad folder, whatever is in it, must not hide the other runs
            found.append(_state_by_tables(folder, error))
    return found


def _state_by_tables(folder: RunFolder, error: Exception) -> RunState:
    """Return the state of a run from its record and tables; its settings cannot be read because of `error`."""
    try:
        run = dict(folder.read_record()["config"]["run"])
    except (ShesError, KeyError, TypeError, ValueError):
        run = {}
    if not isinstance(run.get("env"), str):
        run["env"] = None
    reached: dict[str, Any] = {"generation": None, "env_steps": None, "best_score": None}
    with suppress(RunFolderError, KeyError, ValueError, OverflowError):
        progress = read_csv(folder.progress)
        reached |= {name: int(progress[name][-1]) for name in ("generation", "env_steps")}
        reached["best_score"] = max(read_csv(folder.evaluation)["score_mean"])
    return RunState(
        run=str(folder.path),
        **{name: run.get(name) for name in ("env", "algorithm", "preset", "seed", "generations")},
        **reached,
        state="unregistered" if isinstance(error.__cause__, UnknownNameError) else "unreadable",
        problem=str(error) or type(error).__name__,
    )


def _is_locked(folder: RunFolder) -> bool:
    file = folder.path / ".lock"
    if not file.is_file():
        return False
    with file.open() as opened:
        return not can_lock(opened, is_shared=True)
