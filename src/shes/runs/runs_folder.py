"""Folders of runs that differ in the seed or in swept settings, trained one after another.

Every run is an ordinary run folder. `runs.json` holds the settings of all, so that a folder that was stopped anywhere
goes on with the runs that are missing.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shes.console import LineConsole
from shes.errors import DivergenceError, PolicyError, RunFolderError, ShesError, WorkerError
from shes.listing import Listing
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder, check_folder_of_runs
from shes.runs.interruption import resumable
from shes.runs.listening import AnyListener
from shes.runs.progress_display import ProgressDisplay
from shes.runs.shipped import find_run
from shes.runs.tables import trained_minutes
from shes.runs.train import Run, check_resumable, differing, finish_run
from shes.storage import storage_errors, write_atomically

_RECORD = "runs.json"
_FORMAT = 1
_LENGTHS = ("generations", "env_steps", "minutes")
"""Settings by which a run that has ended can go on."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """A run of a folder that has ended, or the error with which it failed."""

    name: str
    """Its place in the folder."""
    run: Run | None = None
    error: ShesError | None = None


class RunsFolder:
    """A folder of runs, by their places in it."""

    def __init__(self, path: Path, configs: Mapping[str, TrainConfig], ended: set[str]) -> None:
        """Use `create` or `open`."""
        self.path = path
        self.configs = dict(configs)
        self._ended = ended

    @property
    def left(self) -> list[str]:
        """The runs that have not ended, in order."""
        return [name for name in self.configs if name not in self._ended]

    @staticmethod
    def is_at(path: Path | str) -> bool:
        """Return whether there is a folder of runs at `path`."""
        return (Path(path) / _RECORD).is_file()

    @classmethod
    def create(cls, path: Path, configs: Mapping[str, TrainConfig]) -> RunsFolder:
        """Return the folder at `path` with the runs of `configs`; if it has some of them already, it keeps these.

        Raises:
            RunFolderError: `path` is a file or a run folder, or has a run of other settings.
        """
        check_folder_of_runs(path)
        there = cls.open(path) if cls.is_at(path) else cls(path, {}, set())
        for name, config in configs.items():
            before = there.configs.get(name)
            if before is not None and (others := differing(before.numbers(), config.numbers())):
                raise RunFolderError(
                    f"{path} has run {name} with other settings: {others}. Choose another folder with --out."
                )
        kept = {name for name in there._ended if name in configs and _is_as_long(there.configs[name], configs[name])}
        with storage_errors(path):
            path.mkdir(parents=True, exist_ok=True)
        return cls(path, {**there.configs, **configs}, kept | (there._ended - configs.keys()))

    @classmethod
    def open(cls, path: Path | str, **settings: Any) -> RunsFolder:
        """Return the folder of runs at `path`, with execution `settings` that every run shall have from now on.

        `minutes` is the time of every run from now on.

        Raises:
            RunFolderError: Its record is missing or damaged.
            UnknownNameError: An environment or another name in it is not known here.
            ConfigError: A setting would change the numbers of the runs.
        """
        check_resumable(settings)
        path = Path(path)
        file = path / _RECORD
        try:
            record = json.loads(file.read_text(encoding="utf-8"))
            configs, ended = _read(record)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise RunFolderError(f"{file} cannot be read: {error}. Restore it from a copy.") from error
        changed = {name: each.having(**settings) for name, each in configs.items()}
        if settings.get("minutes") is not None:
            spent = {name: trained_minutes(RunFolder(path / name)) for name in changed}
            changed = {name: each.having(minutes=settings["minutes"] + spent[name]) for name, each in changed.items()}
        kept = {name for name in ended if _is_as_long(configs[name], changed[name])}
        return cls(path, changed, kept)

    def train_shown(self, names: list[str]) -> Listing:
        """Train those of the runs `names` that are left and show their progress; return the listing of their ends."""
        displays, errors, console = ExitStack(), list[str](), LineConsole()

        def display_of(name: str) -> ProgressDisplay:
            console.print_line(f"[{names.index(name) + 1}/{len(names)}] {name}")
            return displays.enter_context(ProgressDisplay(console))

        left = [name for name in names if name in self.left]
        with resumable(self.path), displays, closing(self.train(left, display_of)) as outcomes:
            for ended in outcomes:
                displays.close()
                if ended.error is not None:
                    errors.append(f"{ended.name} failed: {ended.error}")
                    console.print_line(errors[-1])
        found = shlex.quote(str(self.path))
        parts = [
            f"Done: {len(names)} runs, one in each folder below {found}.",
            f"Next: shes plot {found} · shes list {found} · shes evaluate {shlex.quote(str(self.path / names[0]))}",
        ]
        if errors:
            parts = []
            errors.append(f"{len(errors)} of {len(names)} runs failed. To go on with them: shes resume {found}")
        return Listing({"runs": names, "errors": errors}, parts, errors)

    def train(self, names: list[str], listener: Callable[[str], AnyListener]) -> Generator[Ended]:
        """Train the runs `names` to their ends, in order, and yield each when it has ended or failed.

        Raises:
            RunFolderError: The folder is in use.
            StorageError: A file cannot be written.
            KeyboardInterrupt: Ctrl-C.
        """
        with RunFolder(self.path).lock():
            self._write()
            for name in names:
                config, path, heard = self.configs[name], self.path / name, listener(name)
                try:
                    if config.run.minutes is not None:
                        left = config.run.minutes - trained_minutes(RunFolder(path))
                        config = config.having(minutes=max(1e-9, left))
                    run = finish_run(config, path, heard)
                except (DivergenceError, PolicyError, RunFolderError, WorkerError) as error:  # of this run alone
                    yield Ended(name=name, error=error)
                else:
                    self._ended.add(name)
                    self._write()
                    yield Ended(name=name, run=run)

    def _write(self) -> None:
        record = {
            "format": _FORMAT,
            "runs": {name: config.to_dict() for name, config in self.configs.items()},
            "ended": [name for name in self.configs if name in self._ended],
        }
        text = json.dumps(record, indent=1) + "\n"
        write_atomically(self.path / _RECORD, lambda file: file.write(text.encode()))


def _read(record: dict[str, Any]) -> tuple[dict[str, TrainConfig], set[str]]:
    """Return the settings of the runs by place, and those that have ended; raise ValueError if it is malformed."""
    if record["format"] != _FORMAT:
        raise ValueError(f"its format is {record['format']!r}, not {_FORMAT}")
    for name in record["runs"]:
        if not re.fullmatch(r"[A-Za-z0-9.+_-]+(/[A-Za-z0-9.+_-]+)?", name) or {".", ".."} & set(name.split("/")):
            raise ValueError(f"{name!r} is no place of a run")
    if not record["runs"]:
        raise ValueError("it has no run")
    configs = {name: TrainConfig.from_dict(each) for name, each in record["runs"].items()}
    return configs, configs.keys() & set(record["ended"])


def _is_as_long(before: TrainConfig, now: TrainConfig) -> bool:
    """Return whether a run ends as before."""
    return all(getattr(before.run, name) == getattr(now.run, name) for name in _LENGTHS)


def find_runs(run: Path | str) -> list[RunFolder]:
    """Return the run folder `run`, or those below it that have a generation, in natural order."""
    path = find_run(run)
    if RunFolder(path).config.is_file() or not path.is_dir():
        return [RunFolder.open(run)]
    found = [folder for folder in RunFolder.below(path) if folder.progress.is_file()]
    if not found and RunsFolder.is_at(path):
        raise RunFolderError(f"no run below {path} has a generation yet. Go on with it: shes resume {path}")
    return found or [RunFolder.open(run)]
