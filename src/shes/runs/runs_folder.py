"""Folders of runs that differ in the seed or in swept settings, trained one after another.

Every run is an ordinary run folder. `runs.json` holds the settings of all, so that a folder that was stopped anywhere
goes on with the runs that are missing.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shes.console import LineConsole
from shes.errors import ConfigError, DivergenceError, PolicyError, RunFolderError, ShesError, WorkerError
from shes.es.noise import NoiseTable
from shes.runs.build import build_algorithm, check_limits
from shes.runs.config import TrainConfig, check_names, known_settings
from shes.runs.folder import RunFolder, differing
from shes.runs.make_config import make_config
from shes.runs.progress_display import ProgressDisplay
from shes.runs.shipped import find_run
from shes.runs.tables import trained_minutes
from shes.runs.train import check_resumable, finish_run, resumable
from shes.settings import Setting, out_of_range
from shes.storage import storage_errors, write_atomically
from shes.types import Listing

_RECORD = "runs.json"
_FORMAT = 1
_MOST_RUNS = 1_000
_ELSEWHERE = {"seed": "Give several seeds by --seed 1 2 3.", "env": "Runs of a folder have one environment."}


def read_sweep(texts: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the values of each swept setting, with their texts as keys, from `name=value,value`.

    Numbers of a tuple are joined by x: `hidden=64x64,32`.
    """
    known = {each.flag.lstrip("-").replace("-", "_"): each for each in known_settings().values()} | known_settings()
    sweep: dict[str, dict[str, Any]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        name = name.strip().lstrip("-").replace("-", "_")
        if not equals or not name:
            raise ConfigError(f"a sweep must be a setting and its values, got {text!r}. Set --sweep sigma=0.02,0.05.")
        if name in _ELSEWHERE:
            raise ConfigError(f"{name} cannot be swept. {_ELSEWHERE[name]}")
        if name not in known:
            check_names({"env": "ant-gather", name: values})  # raises with the nearest name
        setting = known[name]
        if setting.name in sweep:
            raise ConfigError(f"{setting.name} is swept twice. Give all its values at once: {name}=A,B,C.")
        found = {each.strip(): _value(setting, each.strip()) for each in values.split(",")}
        if len(set(map(repr, found.values()))) < values.count(",") + 1:
            raise ConfigError(f"--sweep {text} has a value twice. Remove it.")
        sweep[setting.name] = found
    return sweep


def _value(setting: Setting, text: str) -> Any:
    """Return the value of a setting written as `text`; raise ConfigError or UnknownNameError if it is not allowed."""
    if setting.is_optional and text.lower() == "none":
        return None
    reads = {int: int, float: float, bool: {"true": True, "false": False}.__getitem__}
    read = reads.get(setting.item, str)
    words = [] if text == "none" else text.split("x")
    try:
        value = tuple(map(read, words)) if setting.kind is tuple else read(text)
    except (KeyError, ValueError) as error:
        raise out_of_range(setting.name, text, setting.allowed, f"--sweep {setting.name}=...") from error
    return setting.checked(value)


def vary(
    env: str,
    preset: str | None,
    settings: Mapping[str, Any],
    seeds: Sequence[int],
    sweep: Mapping[str, Mapping[str, Any]],
) -> dict[str, TrainConfig]:
    """Return the settings of a run for every seed and every combination of swept values.

    The keys are the places of the runs in their folder: `seed-1`, or `sigma-0.02_hidden-64/seed-1`. All that can be
    refused is refused here, before the first run.
    """
    if twice := sweep.keys() & settings.keys():
        raise ConfigError(f"{min(twice)} is both given and swept. Omit one.")
    if not seeds:
        raise ConfigError("seed needs at least one value. Set --seed 1 2 3, or omit it.")
    if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
        raise ConfigError(f"seed {twice[0]} is given twice: it would be the same run. Omit one.")
    count = len(seeds) * math.prod(map(len, sweep.values()))
    if count > _MOST_RUNS:
        raise ConfigError(f"these are {count:,} runs; at most {_MOST_RUNS:,} are allowed. Sweep fewer values.")
    found: dict[str, TrainConfig] = {}
    for texts in itertools.product(*sweep.values()):
        values = {name: sweep[name][text] for name, text in zip(sweep, texts, strict=True)}
        words = (f"{name.replace('_', '-')}-{text}" for name, text in zip(sweep, texts, strict=True))
        group = "_".join(re.sub(r"[^A-Za-z0-9.+-]+", "-", word)[:80] for word in words)
        while group and f"{group}/seed-{seeds[0]}" in found:  # the file names of two values may be equal
            group += "-"
        for seed in seeds:
            asked = {**settings, **values, "seed": seed}
            config = make_config(env, asked.pop("preset", preset), asked)
            if seed == seeds[0]:
                check_limits(config, build_algorithm(config).design)
                if "noise_table_size" in config.values:
                    NoiseTable.check_room(config.values["noise_table_size"])
            found[f"{group}/seed-{seed}" if group else f"seed-{seed}"] = config
    return found


@dataclass(frozen=True)
class RunsFolder:
    """A folder of runs; use `create` or `open`."""

    path: Path
    configs: dict[str, TrainConfig]
    """The settings of each run by its place in the folder."""

    @property
    def left(self) -> list[str]:
        """The runs that have not ended, in order."""
        return [name for name in self.configs if self._end(name) is None]

    def _end(self, name: str) -> tuple[str, float] | None:
        """Return a flag and its value that let a run go on which has ended; None if it has not."""
        folder, run = RunFolder(self.path / name), self.configs[name].run
        try:
            last = folder.load("last", with_state=False)
            if run.is_over(last.generation, last.env_steps):
                return "--generations", 2 * run.generations
            return ("--minutes", run.minutes) if run.minutes and trained_minutes(folder) >= run.minutes else None
        except ShesError:  # it has not begun, or is damaged, which shows when it goes on
            return None

    @property
    def how_to_go_on(self) -> str:
        """The command that goes on with runs that have ended, those out of time if there are any."""
        ends = filter(None, map(self._end, self.configs))
        limit = [f"{flag} {value:.15g}" for flag, value in sorted(ends)[-1:]]
        return " ".join(["shes resume", shlex.quote(str(self.path)), *limit])

    @staticmethod
    def is_at(path: Path | str) -> bool:
        """Return whether there is a folder of runs at `path`."""
        return (Path(path) / _RECORD).is_file()

    @classmethod
    def create(cls, path: Path, configs: Mapping[str, TrainConfig]) -> RunsFolder:
        """Return the folder at `path` with the runs of `configs`; if it has some of them already, it keeps these."""
        RunFolder(path).check_free()
        there = cls.open(path).configs if cls.is_at(path) else {}
        for name, config in configs.items():
            if name in there and (others := differing(there[name].numbers(), config.numbers())):
                raise RunFolderError(
                    f"{path} has run {name} with other settings: {others}. Choose another folder with --out."
                )
        with storage_errors(path):
            path.mkdir(parents=True, exist_ok=True)
        return cls(path, {**there, **configs})

    @classmethod
    def open(cls, path: Path | str, **settings: Any) -> RunsFolder:
        """Return the folder of runs at `path`, with execution `settings` that every run shall have from now on.

        `minutes` is the time of every run from now on.
        """
        check_resumable(settings)
        file, minutes = Path(path) / _RECORD, settings.get("minutes")
        try:
            record = json.loads(file.read_text(encoding="utf-8"))
            configs = {name: TrainConfig.from_dict(each) for name, each in record["runs"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise RunFolderError(f"{file} cannot be read: {error}. Restore it from a copy.") from error
        if record.get("format") != _FORMAT or not configs:
            raise RunFolderError(f"{file} has no runs in format {_FORMAT}. Restore it from a copy.")
        for name, config in configs.items():
            if minutes is not None:
                settings["minutes"] = minutes + trained_minutes(RunFolder(file.parent / name))
            configs[name] = config.having(**settings)
        return cls(file.parent, configs)

    def train_shown(self, names: list[str]) -> Listing:
        """Train those of the runs `names` that are left to their ends, in order, and show their progress.

        An error of one run does not stop the others.

        Returns:
            The listing of what has ended and failed.
        """
        errors, console = list[str](), LineConsole()
        with resumable(self.path), RunFolder(self.path).lock():
            record = {"format": _FORMAT, "runs": {name: config.to_dict() for name, config in self.configs.items()}}
            text = json.dumps(record, indent=1) + "\n"
            write_atomically(self.path / _RECORD, lambda file: file.write(text.encode()))
            for name in self.left:
                if name not in names:
                    continue
                console.print_line(f"[{names.index(name) + 1}/{len(names)}] {name}")
                try:
                    with ProgressDisplay(console) as display:
                        finish_run(self.configs[name], self.path / name, display)
                except (DivergenceError, PolicyError, RunFolderError, WorkerError) as error:  # of this run alone
                    errors.append(f"{name} failed: {error}")
                    console.print_line(errors[-1])
        found = shlex.quote(str(self.path))
        if errors:
            errors.append(f"{len(errors)} of {len(names)} runs failed. To go on with them: shes resume {found}")
            return Listing({"runs": names, "errors": errors}, [], errors)
        parts = [
            f"Done: {len(names)} runs, one in each folder below {found}.",
            f"Next: shes plot {found} · shes list {found} · shes evaluate {shlex.quote(str(self.path / names[0]))}",
        ]
        if "--minutes" in (command := self.how_to_go_on):
            parts.insert(1, f"Some of them stopped with their time. Go on: {command}")
        return Listing({"runs": names, "errors": errors}, parts, errors)


def find_runs(run: Path | str) -> list[RunFolder]:
    """Return the run folder `run`, or those below it that have a generation, in natural order."""
    path = find_run(run)
    if RunFolder(path).config.is_file() or not path.is_dir():
        return [RunFolder.open(run)]
    found = [folder for folder in RunFolder.below(path) if folder.progress.is_file()]
    if not found and RunsFolder.is_at(path):
        raise RunFolderError(f"no run below {path} has a generation yet. Go on with it: shes resume {path}")
    return found or [RunFolder.open(run)]
