"""`python -m experiments ship RUN NAME ...`: make a shipped agent from a checkpoint of a run.

It is made and evaluated in a temporary folder, and then moved to its place: it is never incomplete.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from shes.errors import ConfigError, RunFolderError
from shes.runs import shipped
from shes.runs.build import open_run
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.shipped import AGENT_FILE, FreshEvaluation, FreshScore, ShippedAgent
from shes.runs.tables import csv_text, read_csv
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

    The arguments are those of the command line, see `main`.
    """
    place = shipped.AGENTS if into is None else Path(into)
    if not _NAME.fullmatch(name):
        raise ConfigError(f"name must be small letters, digits and hyphens, e.g. ant-walker, got {name!r}.")
    if not description.strip() or "\n" in description:
        raise ConfigError(f"description must be one line of text, got {description!r}. Set --description.")
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
        _copy(source, checkpoint, chosen, folder)
        config, record = source.read_config(), source.read_record()
        is_on_one = config.workers.backend == "serial" or config.workers.device != "cpu"
        tables = [read_csv(each.progress) for each in (source, *(RunFolder.open(each) for each in earlier))]
        agent = ShippedAgent(
            description=description,
            env=config.run.env,
            commands=list(commands),
            cores=1 if is_on_one else config.workers.num_workers or record["machine"]["cores"],
            hours=round(sum(table["wall_time_s"][-1] for table in tables) / 3600, 3),
            env_steps=sum(int(table["env_steps"][-1]) for table in tables),
            generation=chosen.generation,
            evaluation=fresh_evaluation(folder, episodes=episodes, seed=seed, num_workers=num_workers),
        )
        text = json.dumps(asdict(agent), indent=2, ensure_ascii=False) + "\n"
        write_atomically(folder.path / AGENT_FILE, lambda file: file.write(text.encode()))
        with storage_errors(place / name):
            folder.path.rename(place / name)
    return agent


def fresh_evaluation(run: RunFolder, *, episodes: int, seed: int | None, num_workers: int) -> FreshEvaluation:
    """Return the result of the agent in `run` and, if it has a controller, of other ones on the same episodes."""
    result = partial(evaluate, run.path, episodes=episodes, seed=seed, num_workers=num_workers)
    trained = result()
    others = [result(controller="constant"), result(controller="random")] if trained.controller else [None, None]
    constant, random = (each and FreshScore.of(each.listing().facts) for each in others)
    return FreshEvaluation.of(trained.listing().facts, seed=seed, constant=constant, random=random)


def _copy(source: RunFolder, name: str, checkpoint: Checkpoint, target: RunFolder) -> None:
    """Copy the files of an agent, checkpoint `name` of `source`, to `target`, without local paths."""
    record = _without_paths(source.read_record())
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


def main(words: Sequence[str]) -> int:
    """Make a shipped agent from a command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments ship", description="Make a shipped agent from a run.")
    parser.add_argument("run", metavar="RUN", help="the run folder")
    parser.add_argument("name", metavar="NAME", help="name of the agent, e.g. ant-walker")
    parser.add_argument("--description", required=True, help="what it does, on one line")
    parser.add_argument(
        "--command", required=True, action="append", dest="commands", help="a command that trained it; repeatable"
    )
    parser.add_argument("--checkpoint", default="best", help="best, last or the number of a generation (default: best)")
    parser.add_argument("--episodes", type=int, default=200, help="fresh episodes of its evaluation (default: 200)")
    parser.add_argument("--seed", type=int, help="seed of the episodes; derived from that of the run if none")
    parser.add_argument("--workers", type=int, default=0, dest="num_workers", help="0 is one for every core")
    parser.add_argument("--earlier", nargs="+", default=(), metavar="RUN", help="runs whose time and steps are added")
    parser.add_argument("--into", metavar="DIR", help="folder of shipped agents; that of the package if none")
    agent = ship(**vars(parser.parse_args(words)))
    print(json.dumps(asdict(agent), indent=2, ensure_ascii=False))
    return 0
