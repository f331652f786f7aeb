"""The run folder: where it keeps what, and that there is exactly one run in it."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from shes.errors import CheckpointError, ConfigError, RunFolderError, UnknownNameError
from shes.experiments.checkpoint import Checkpoint, load_checkpoint
from shes.experiments.config import TrainConfig
from shes.experiments.storage import storage_errors, write_atomically

__all__ = ["RunFolder", "default_path"]

_FORMAT = 1
_PACKAGES = ("shes", "mujoco", "numpy", "gymnasium")


def default_path(config: TrainConfig) -> Path:
    """Return a new folder below `runs/` in the working directory."""
    return Path("runs") / f"{config.env}-{config.preset}-seed{config.seed}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"


class RunFolder:
    """`config.json`, `progress.csv`, `evaluation.csv`, `checkpoints/`, `tensorboard/`, `log.txt`."""

    def __init__(self, path: Path) -> None:
        """Name the files below `path`; use `create` or `open`."""
        self.path = path
        self.config = path / "config.json"
        self.progress = path / "progress.csv"
        self.evaluation = path / "evaluation.csv"
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self.log = path / "log.txt"

    @classmethod
    def create(cls, path: Path) -> RunFolder:
        """Make a folder at `path`; it holds a run as soon as `record_start` has written its record.

        Raises:
            RunFolderError: `path` already holds a run, or is a file.
            StorageError: It cannot be written.
        """
        folder = cls(path)
        if folder.config.exists():
            raise RunFolderError(
                f"{path} already holds a run. Go on with it by `shes resume {path}`, "
                "or choose another folder with --out."
            )
        if path.exists() and not path.is_dir():
            raise RunFolderError(f"{path} is a file, not a folder. Choose another path with --out.")
        with storage_errors(path):
            folder.checkpoints.mkdir(parents=True, exist_ok=True)
        return folder

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Return the run folder at `path`.

        Raises:
            RunFolderError: `path` is not a run folder.
        """
        folder = cls(path)
        if not folder.config.is_file():
            what = "does not exist" if not path.exists() else "is not a run folder: it has no config.json"
            raise RunFolderError(f"{path} {what}. Give the folder that `shes train` printed (its --out).")
        return folder

    def read_config(self) -> TrainConfig:
        """Return the settings of the run.

        Raises:
            RunFolderError: `config.json` is damaged.
            ConfigError: A setting in it is unknown, or its value is not allowed.
        """
        record = self._read_record()
        try:
            return TrainConfig.from_dict(record["config"])
        except (KeyError, TypeError, AttributeError) as error:
            raise RunFolderError(f"{self.config} is damaged: {error!r}. Restore it from a copy.") from error
        except (ConfigError, UnknownNameError) as error:
            raise ConfigError(f"{self.config}: {error}") from error

    def record_start(self, config: TrainConfig) -> None:
        """Write down what the run is.

        Raises:
            StorageError: It cannot be written.
        """
        self._write_record({"format": _FORMAT, "config": config.to_dict(), **_provenance(), "resumed": []})

    def record_resume(self, generation: int, config: TrainConfig) -> None:
        """Write down that the run went on from `generation`, with what versions and settings."""
        record = self._read_record()
        record["config"] = config.to_dict()
        record["resumed"] = [*record.get("resumed", []), {"generation": generation, **_provenance()}]
        self._write_record(record)

    def checkpoint_path(self, name: str) -> Path:
        """Return the file of checkpoint `name`: `last`, `best` or the number of a generation."""
        return self.checkpoints / (f"generation_{int(name):06d}.npz" if name.isdecimal() else f"{name}.npz")

    def load(self, name: str) -> Checkpoint:
        """Return checkpoint `name` of this run.

        Raises:
            CheckpointError: It is missing, damaged, or of another run.
        """
        path = self.checkpoint_path(name)
        checkpoint = load_checkpoint(path)
        mine = self.read_config().numbers()
        if checkpoint.numbers != mine:
            keys = sorted(mine.keys() | checkpoint.numbers.keys())
            other = [key for key in keys if checkpoint.numbers.get(key) != mine.get(key)]
            shown = ", ".join(f"{key} is {checkpoint.numbers.get(key)!r}, not {mine.get(key)!r}" for key in other[:3])
            raise CheckpointError(f"{path} is of another run: {shown}. Put back the checkpoint of this run.")
        return checkpoint

    def _read_record(self) -> dict[str, Any]:
        try:
            record = json.loads(self.config.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RunFolderError(f"{self.config} cannot be read: {error}. Restore it from a copy.") from error
        if not isinstance(record, dict) or record.get("format") != _FORMAT:
            raise RunFolderError(f"{self.config} is not the record of a SHES run of format {_FORMAT}.")
        return record

    def _write_record(self, record: dict[str, Any]) -> None:
        text = json.dumps(record, indent=2) + "\n"
        write_atomically(self.config, lambda file: file.write(text.encode()))


def _provenance() -> dict[str, Any]:
    """Return when, where, by what command and with what versions this process runs."""
    versions = {name: metadata.version(name) for name in _PACKAGES}
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": ["shes", *sys.argv[1:]],
        "versions": {"python": platform.python_version(), **versions},
        "git_commit": _git_commit(),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
    }


def _git_commit() -> str | None:
    """Return the commit of the source tree that this package is in, if it is in one."""
    try:
        asked = subprocess.run(
            ["git", "rev-parse", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=5,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return asked.stdout.strip()


def _processor() -> str:
    """Return the processor's name: results repeat to the bit only on processors with the same features."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())
