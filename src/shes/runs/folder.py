"""The run folder: its files, its lock, and its record with the provenance of the run."""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib import metadata
from itertools import count
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from shes.envs.bodies.robot_file import read_robot, robot_stem
from shes.envs.named_environments import GYMNASIUM
from shes.errors import CheckpointError, ConfigError, RunFolderError, UnknownNameError
from shes.runs.checkpoint import Checkpoint, load_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.shipped import find_run, shipped_hint, shipped_name
from shes.sim.warp_device import WarpDevice
from shes.storage import can_lock, storage_errors, write_atomically

_FORMAT = 2
_DEPTH = 4  # of `runs/SWEEP/VALUE/seed-1` in the working directory
_LOCK_S = 0.5
"""How long a lock is waited for: a list of runs takes it for a moment."""
_PACKAGES = ("shes", "mujoco", "numpy")
_KINDS = {"config": dict, "versions": dict, "device": dict, "command": list}
"""Types in the record, and in each entry of its list `resumed`."""


class RunFolder:
    """`config.json`, `progress.csv`, `evaluation.csv`, `checkpoints/`, `tensorboard/`, `log.txt`, `robot/`."""

    def __init__(self, path: Path) -> None:
        """Name the files below `path`; use `create` or `open`."""
        self.path = path
        self.config = path / "config.json"
        self.progress = path / "progress.csv"
        self.evaluation = path / "evaluation.csv"
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self.log = path / "log.txt"
        self.robots = path / "robot"
        self._lock = path / ".lock"

    @classmethod
    def create(cls, path: Path) -> RunFolder:
        """Create the folder at `path`; it holds a run once `record_start` has written its record."""
        folder = cls(path)
        folder.check_free()
        with storage_errors(path):
            folder.checkpoints.mkdir(parents=True, exist_ok=True)
        return folder

    def check_free(self) -> None:
        """Raise RunFolderError if the path holds a run or parts of one, or is a file."""
        path = self.path
        if self.config.exists():
            raise RunFolderError(
                f"{path} already holds a run. Go on with it by `shes resume {path}`, "
                "or choose another folder with --out."
            )
        if path.exists() and not path.is_dir():
            raise RunFolderError(f"{path} is a file, not a folder. Choose another path with --out.")
        # An interrupted start leaves the lock and first checkpoints; other files come from elsewhere.
        checkpoints = [] if self._lock.exists() else self.checkpoints.glob("*.npz")
        taken = next((file for file in (self.progress, self.evaluation, *checkpoints) if file.exists()), None)
        if taken is not None:
            raise RunFolderError(
                f"{path} holds {taken.relative_to(path)} but no config.json: parts of a run, or another program's "
                "files. Choose another folder with --out."
            )

    @classmethod
    def open(cls, run: Path | str) -> RunFolder:
        """Return the run folder `run`, a path or the name of a shipped agent; raise RunFolderError if it is neither."""
        folder = cls(find_run(run))
        path = folder.path
        if folder.config.is_file():
            return folder
        if below := cls.below(path):
            raise RunFolderError(f"{path} is no run folder. Give one below it ({len(below)}), e.g. {below[0].path}.")
        what = f"is not a run folder: no config.json is in it or up to {_DEPTH} levels below"
        raise RunFolderError(
            f"{path} {what if path.exists() else 'does not exist'}. "
            f"Give the folder that `shes train` printed (its --out).{shipped_hint(run)}"
        )

    @classmethod
    def below(cls, path: Path) -> list[RunFolder]:
        """Return the run folders up to `_DEPTH` levels below `path`, in natural order; none of other programs."""
        found = list[RunFolder]()
        for place, folders, files in os.walk(path):
            found += [cls(Path(place))] if "config.json" in files else []
            folders[:] = folders if len(Path(place).parts) - len(path.parts) < _DEPTH else []
        known = [each for each in found if each.checkpoints.is_dir() or each.progress.is_file()]
        return sorted(known, key=lambda folder: _natural(folder.path))

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the lock of the folder, so that no other process trains in it."""
        name = shipped_name(self.path)
        if name is not None:
            raise RunFolderError(
                f"{name} is a shipped agent, part of the package, and nothing is written into it. Begin a run with its "
                f"primitive: shes train ENV --primitive {name}. Or copy {self.path} to a folder of your own, with its "
                "checkpoints/best.npz as checkpoints/last.npz, and resume that."
            )
        with storage_errors(self._lock):
            file = self._lock.open("w")
        with file:
            give_up = monotonic() + _LOCK_S
            while not can_lock(file):
                if monotonic() > give_up:
                    raise RunFolderError(
                        f"{self.path} is in use: another process trains in it. Wait for its end, or choose another "
                        "folder."
                    )
                sleep(_LOCK_S / 10)
            yield

    def is_locked(self) -> bool:
        """Return whether a process trains in the folder."""
        if not self._lock.is_file():
            return False
        with self._lock.open() as file:
            return not can_lock(file, is_shared=True)

    def read_record(self) -> dict[str, Any]:
        """Return the content of `config.json`, settings and provenance; raise RunFolderError if it is damaged."""
        try:
            record = json.loads(self.config.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise RunFolderError(f"{self.config} cannot be read: {error}. Restore it from a copy.") from error
        if not isinstance(record, dict) or record.get("format") != _FORMAT:
            raise RunFolderError(
                f"{self.config} is not the record of a SHES run of format {_FORMAT}. Give the folder that `shes train` "
                "printed; a run of another version of SHES needs that version."
            )
        resumed = record.get("resumed", [])
        for part in [record, *resumed] if isinstance(resumed, list) else [None]:
            if not isinstance(part, dict) or not all(
                isinstance(part.get(name, kind()), kind) for name, kind in _KINDS.items()
            ):
                raise RunFolderError(
                    f"{self.config} is damaged: one of resumed, {', '.join(_KINDS)} is not what a run writes. Restore "
                    "it from a copy."
                )
        return record

    def read_config(self) -> TrainConfig:
        """Return the settings of the run; raise RunFolderError or ConfigError if its record is not one."""
        record = self.read_record()
        try:
            config = TrainConfig.from_dict(record["config"])
            copies = sorted(self.robots.glob("*.zip"))
            return config.having(robot=str(copies[0])) if copies else config
        except (KeyError, TypeError, AttributeError) as error:
            raise RunFolderError(f"{self.config} is damaged: {error!r}. Restore it from a copy.") from error
        except (ConfigError, UnknownNameError) as error:
            raise ConfigError(f"{self.config}: {error}") from error

    def write_record(self, record: dict[str, Any]) -> None:
        """Write `config.json`; raise StorageError if that fails."""
        text = json.dumps(record, indent=2) + "\n"
        write_atomically(self.config, lambda file: file.write(text.encode()))

    def record_start(self, config: TrainConfig, origins: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the record of a new run, with the origins of levels that other runs trained."""
        here = provenance(config.workers.device, config.algorithm.packages)
        if robot := config.values.get("robot"):
            content = read_robot(robot).content
            with storage_errors(self.robots):
                self.robots.mkdir(exist_ok=True)
            write_atomically(self.robots / f"{robot_stem(robot)}.zip", lambda file: file.write(content))
        self.write_record({"format": _FORMAT, "config": config.to_dict(), **origins, **here, "resumed": []})

    def record_resume(self, generation: int, config: TrainConfig) -> list[str]:
        """Record that the run was resumed after `generation`; return the changes that may change numbers."""
        record, here = self.read_record(), provenance(config.workers.device, config.algorithm.packages)
        changes = _changes_since(record, here)
        record["config"] = config.to_dict()
        record["resumed"] = [*record.get("resumed", []), {"generation": generation, **here}]
        self.write_record(record)
        return changes

    def checkpoint_path(self, name: str | int) -> Path:
        """Return the path of checkpoint `name`: `last`, `best` or the number of a generation."""
        return self.checkpoints / (f"generation_{int(name):06d}.npz" if str(name).isdecimal() else f"{name}.npz")

    def load(self, name: str | int, *, with_state: bool = True) -> Checkpoint:
        """Return checkpoint `name` of this run; for `with_state` see `load_checkpoint`."""
        path, agent = self.checkpoint_path(name), shipped_name(self.path)
        if agent is not None and not path.is_file():
            raise CheckpointError(
                f"the shipped agent {agent} has only the checkpoint best, got {name!r}. Omit the checkpoint."
            )
        checkpoint, config = load_checkpoint(path, with_state=with_state), self.read_config()
        mine, settings = config.numbers(), config.settings
        # Settings that are newer than the checkpoint have their defaults, which change nothing.
        theirs = {name: checkpoint.numbers.get(name, settings[name].default) for name in mine}
        if others := differing(theirs, mine):
            raise CheckpointError(f"{path} is of another run: {others}. Put back the checkpoint of this run.")
        return replace(checkpoint, numbers=mine)


def checked_out(out: Path | str) -> Path:
    """Return `out` as a path; raise ConfigError if it is not one."""
    if not isinstance(out, str | os.PathLike) or not str(out):
        raise ConfigError(f"out must be the path of a folder, got {out!r}. Set --out, or omit it.")
    return Path(out)


def new_folder(config: TrainConfig, kind: str = "") -> Path:
    """Create a new folder below `runs/` in the working directory and return it; safe for concurrent runs.

    Its name has environment, preset, `kind` and time; `kind` is the seed if empty.
    """
    env = config.run.env.removeprefix(GYMNASIUM).replace("/", "-")
    kind = kind or f"seed{config.run.seed}"
    name = f"{env}-{config.run.preset}-{kind}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    path = Path("runs") / name
    for number in count(2):
        with storage_errors(path), suppress(FileExistsError):
            path.mkdir(parents=True)
            break
        path = path.with_name(f"{name}-{number}")
    return path


def differing(there: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return the first settings in which two runs differ, in words; empty if they are the same."""
    names = [name for name in {**wanted, **there} if there.get(name) != wanted.get(name)]
    return ", ".join(f"{name} is {there.get(name)!r}, not {wanted.get(name)!r}" for name in names[:3])


def _natural(path: Path) -> list[float | str]:
    """Return a key that orders paths by their numbers: seed-2 before seed-10."""
    return [float(word) if index % 2 else word for index, word in enumerate(re.split(r"(\d+(?:\.\d+)?)", str(path)))]


def provenance(device: str, packages: Iterable[str] = ()) -> dict[str, Any]:
    """Return time, command, versions, machine and `device` of a run of this process, as JSON types.

    Its versions are those of the packages that every run uses, and of those of `packages` that are installed.
    """
    versions = {"python": platform.python_version()}
    for name in (*_PACKAGES, *packages):
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    file = Path(sys.argv[0])
    program = ["python", "-m", file.parent.name] if file.name == "__main__.py" else [file.name]
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": [*program, *sys.argv[1:]],
        "versions": versions,
        "git_commit": _git_commit(),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "device": {"name": device} if device == "cpu" else WarpDevice(device).facts,
    }


def _changes_since(record: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the changes that may change numbers: `numpy 2.4 -> 2.5`, `device cpu -> cuda`.

    Versions are compared with those at the start of the run with this record, the device with that of its last part.
    """
    last = [record, *record.get("resumed", [])][-1].get("device", {"name": "cpu"})
    here = now["device"] if last.get("name") == now["device"]["name"] else {"name": now["device"]["name"]}
    pairs = [(name, record.get("versions", {}).get(name, own), own) for name, own in now["versions"].items()]
    pairs += [("device" if name == "name" else name, last.get(name), own) for name, own in here.items()]
    return [f"{name} {before} -> {own}" for name, before, own in pairs if before != own]


def _git_commit() -> str | None:
    """Return the git commit of this package's source tree; None if the package is not in a repository."""
    here = Path(__file__)
    try:
        for command in (["ls-files", "--error-unmatch", here.name], ["rev-parse", "HEAD"]):
            asked = subprocess.run(
                ["git", *command], cwd=here.parent, capture_output=True, text=True, check=True, timeout=5
            )
    except (OSError, subprocess.SubprocessError):
        return None
    return asked.stdout.strip()


def _processor() -> str:
    """Return the processor's name: results are bit-identical only between processors with the same features."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())
