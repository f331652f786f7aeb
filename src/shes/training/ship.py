"""`python -m shes.training.ship RUN NAME ...`: make a shipped agent from a checkpoint of a run.

It is made and evaluated in a temporary folder, and then moved to its place: it is never incomplete.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from shes.errors import ConfigError, RunFolderError, ShesError
from shes.runs import shipped
from shes.runs.build import open_run
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.evaluate import Evaluation, evaluate
from shes.runs.folder import RunFolder
from shes.runs.shipped import AGENT_FILE, FreshEvaluation, FreshScore, ShippedAgent
from shes.runs.tables import csv_text, read_csv
from shes.runs.transfer import transferred_levels
from shes.storage import storage_errors, write_atomically

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_MOST_ROWS = 300
_DIGITS = 6
"""Significant digits of numbers in the tables."""


def ship(
    run: Path | str,
    name: str,
    *,
    description: str,
    commands: Sequence[str],
    checkpoint: str = "best",
    episodes: int = 200,
    seed: int | None = None,
    num_workers: int = 0,
    into: Path | str | None = None,
    earlier: Sequence[Path | str] = (),
) -> ShippedAgent:
    """Make the shipped agent `name` from a checkpoint of `run`, and return its description.

    Args:
        run: The run folder.
        name: Its name: lower-case letters, digits and hyphens.
        description: What it does, on one line.
        commands: The commands that trained it. The record takes the names of run folders from the last one (`--out`,
            `--primitive`).
        checkpoint: `best`, `last` or the number of a generation.
        episodes: Number of fresh episodes of its evaluation.
        seed: Seed of the episodes; derived from that of the run if none.
        num_workers: Worker processes; 0 is one for every core.
        into: Folder of shipped agents; that of the package if none.
        earlier: Runs that came before this one, such as its primitive's: their time and steps are added.

    Raises:
        RunFolderError: `run` is not a run folder or has no evaluation yet, or the agent exists.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The name, the description, the commands or a number is invalid.
        StorageError: A file cannot be written.
    """
    place = shipped.AGENTS if into is None else Path(into)
    _check_words(name, description, commands)
    if (place / name).exists():
        raise RunFolderError(f"{place / name} exists already. Delete it first, or choose another name.")
    source = RunFolder.open(run)
    chosen = source.load(checkpoint)
    if chosen.best.generation < 0:
        raise RunFolderError(f"{source.path} has no evaluation yet, and so no best checkpoint. Train it further first.")
    with storage_errors(place):
        place.mkdir(exist_ok=True)
        temporary = TemporaryDirectory(prefix=f".{name}.", dir=place)
    with temporary:
        folder = RunFolder.create(Path(temporary.name) / name)
        _copy(source, checkpoint, chosen, folder, commands[-1])
        found = fresh_evaluation(folder, episodes=episodes, seed=seed, num_workers=num_workers)
        runs = [source, *(RunFolder.open(each) for each in earlier)]
        agent = _describe(runs, chosen, found, description, commands)
        text = json.dumps(agent.to_dict(), indent=2, ensure_ascii=False) + "\n"
        write_atomically(folder.path / AGENT_FILE, lambda file: file.write(text.encode()))
        with storage_errors(place / name):
            folder.path.rename(place / name)
    return agent


def fresh_evaluation(run: RunFolder, *, episodes: int, seed: int | None, num_workers: int) -> FreshEvaluation:
    """Return the result of the agent in `run` and, if it has a controller, of other ones on the same episodes."""
    result = partial(evaluate, run.path, episodes=episodes, seed=seed, num_workers=num_workers)
    trained = result()
    others = [result(controller="constant"), result(controller="random")] if trained.controller else [None, None]
    constant, random = (each and FreshScore(**_shared(each, FreshScore)) for each in others)
    return FreshEvaluation(seed=seed, constant=constant, random=random, **_shared(trained, FreshEvaluation))


def _shared(found: Evaluation, kind: type[FreshScore]) -> dict[str, Any]:
    """Return the fields of `kind` that `found` or its summary has."""
    values = {**found.summary(), "controller": found.controller}
    return {field.name: values[field.name] for field in fields(kind) if field.name in values}


def _check_words(name: str, description: str, commands: Sequence[str]) -> None:
    """Raise ConfigError if the name, the description or the commands are invalid."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f"name must be small letters, digits and hyphens, e.g. ant-walker, got {name!r}.")
    if not description.strip() or "\n" in description:
        raise ConfigError(f"description must be one line of text, got {description!r}. Set --description.")
    if not commands or not all(command.strip() for command in commands):
        raise ConfigError(f"commands must name at least one, got {list(commands)!r}. Set --command.")
    try:
        shlex.split(commands[-1])
    except ValueError as error:
        raise ConfigError(f"commands must be a shell's, got {commands[-1]!r} ({error}). Set --command.") from error


def _describe(
    runs: Sequence[RunFolder],
    checkpoint: Checkpoint,
    found: FreshEvaluation,
    description: str,
    commands: Sequence[str],
) -> ShippedAgent:
    """Return the description of the agent of `checkpoint`, of the first of `runs`, with its evaluation `found`.

    Its time and steps are those of all runs.
    """
    config, tables = runs[0].read_config(), [read_csv(run.progress) for run in runs]
    return ShippedAgent(
        description=description,
        env=config.run.env,
        commands=tuple(commands),
        cores=_cores(config, runs[0]),
        hours=round(sum(table["wall_time_s"][-1] for table in tables) / 3600, 3),
        env_steps=sum(int(table["env_steps"][-1]) for table in tables),
        generation=checkpoint.generation,
        evaluation=found,
    )


def _copy(source: RunFolder, name: str, checkpoint: Checkpoint, target: RunFolder, command: str) -> None:
    """Copy the files of an agent, checkpoint `name` of `source`, to `target`.

    There are no local paths in them, and run folders are named as in `command`.
    """
    record = _with_names_of(command, _without_paths(source.read_record()))
    config = TrainConfig.from_dict(record["config"])
    record["config"] = config.to_dict()
    target.write_record(record)
    opened = open_run(source.path, name)
    arrays = opened.algorithm.to_arrays(opened.algorithm.without_training(opened.state))
    best = checkpoint.best if checkpoint.best.generation == checkpoint.generation else Best()
    shipped_checkpoint = replace(checkpoint, arrays=arrays, best=best, numbers=config.numbers())
    save_checkpoint(target.checkpoint_path("best"), shipped_checkpoint, is_compressed=True)
    for table, copy in ((source.progress, target.progress), (source.evaluation, target.evaluation)):
        _copy_table(table, copy, checkpoint.generation)


def _without_paths(value: Any) -> Any:
    """Return a JSON value with every absolute path, also after `--flag=`, reduced to its last part."""
    if isinstance(value, dict):
        return {key: _without_paths(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_paths(item) for item in value]
    if not isinstance(value, str):
        return value
    flag, equals, path = value.partition("=") if value.startswith("--") else ("", "", value)
    return flag + equals + PurePosixPath(path).name if path.startswith(("/", "~")) else value


def _with_names_of(command: str, record: dict[str, Any]) -> dict[str, Any]:
    """Return `record` with its run folders named as in `command`, if that names them."""
    words = shlex.split(command)
    pairs = [*pairwise(words), *(word.partition("=")[::2] for word in words)]
    run_options = {"--out", *(f"--{level}" for level in transferred_levels())}
    names = {option: name for option, name in pairs if option in run_options and name}
    for level in transferred_levels():
        if f"--{level}" in names and record.get(level) is not None:
            record[level]["run"] = names[f"--{level}"]
            section = next(section for section in record["config"].values() if level in section)
            section[level] = names[f"--{level}"]
    for part in (record, *record.get("resumed", ())):
        part["command"] = _rename_runs(part.get("command", ()), names)
    return record


def _rename_runs(words: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """Return the words of a command with its run folders replaced by `names`, by option."""
    renamed = list[str]()
    for before, word in pairwise(("", *words)):
        option, equals, _ = word.partition("=")
        if equals and option in names:
            word_now = option + equals + names[option]
        elif before == "resume" and not word.startswith("-"):
            word_now = names.get("--out", word)
        else:
            word_now = names.get(before, word)
        renamed.append(word_now)
    return renamed


def _copy_table(source: Path, target: Path, generation: int) -> None:
    """Copy at most `_MOST_ROWS` rows of a table, rounded: first, last and that of `generation` included."""
    columns = read_csv(source)
    with source.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    kept = set(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_ROWS - 1)).round().astype(int).tolist())
    kept |= {number for number, each in enumerate(columns["generation"]) if each == generation}
    text = csv_text([header, *([_rounded(cell) for cell in rows[number]] for number in sorted(kept))])
    write_atomically(target, lambda file: file.write(text.encode()))


def _rounded(cell: str) -> str:
    """Return a number of a table with `_DIGITS` significant digits; an integer unchanged."""
    return cell if cell.lstrip("-").isdecimal() else f"{float(cell):.{_DIGITS}g}"


def _cores(config: TrainConfig, run: RunFolder) -> int:
    """Return the number of cores of a run: one per worker."""
    if config.workers.backend == "serial" or config.workers.device != "cpu":
        return 1
    return config.workers.num_workers or run.read_record()["machine"]["cores"]


def main(words: Sequence[str] | None = None) -> int:
    """Make a shipped agent from the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m shes.training.ship", description="Make a shipped agent from a run."
    )
    parser.add_argument("run", metavar="RUN", help="the run folder")
    parser.add_argument("name", metavar="NAME", help="name of the agent, e.g. ant-walker")
    text, number = {"metavar": "TEXT", "required": True}, {"metavar": "INT", "type": int}
    parser.add_argument("--description", **text, help="what it does, on one line")
    parser.add_argument(
        "--command", **text, action="append", dest="commands", help="a command that trained it; repeatable"
    )
    parser.add_argument("--checkpoint", default="best", help="best, last or the number of a generation (default: best)")
    parser.add_argument("--episodes", **number, default=200, help="fresh episodes of its evaluation (default: 200)")
    parser.add_argument("--seed", **number, help="seed of the episodes; derived from that of the run if none")
    parser.add_argument("--workers", **number, default=0, dest="num_workers", help="0 is one for every core")
    parser.add_argument(
        "--earlier",
        metavar="RUN",
        nargs="+",
        default=(),
        help="runs that came before this one, such as its primitive's: their time and steps are added",
    )
    parser.add_argument("--into", metavar="DIR", help="folder of shipped agents; that of the package if none")
    given = vars(parser.parse_args(words))
    try:
        agent = ship(given.pop("run"), given.pop("name"), **given)
    except ShesError as error:
        print(f"Error: {error}", file=sys.stderr)
        return error.exit_code
    print(json.dumps(agent.to_dict(), indent=2, ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
