"""The provenance of a run: time, command, versions, machine and device."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from shes.sim.warp_device import WarpDevice

_PACKAGES = ("shes", "mujoco", "numpy")


def provenance(device: str, packages: Iterable[str] = ()) -> dict[str, Any]:
    """Return the provenance of a run of this process on `device`, as JSON types.

    Its versions are those of the packages that every run uses, and of those of `packages` that are installed.

    Raises:
        MissingExtraError: The device needs a package that is not installed.
        ConfigError: The machine has no such device, or software versions do not match.
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


def changes_since(record: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the changes that may change numbers: `numpy 2.4 -> 2.5`, `device cpu -> cuda`.

    Versions are compared with those at the start of the run with this record, the device with that of its last part.
    """
    began = record.get("versions", {})  # an older run did not record all of them
    changes = [
        f"{name} {began[name]} -> {version}"
        for name, version in now["versions"].items()
        if began.get(name, version) != version
    ]
    before = [record, *record.get("resumed", [])][-1].get("device", {"name": "cpu"})
    if before.get("name") != now["device"]["name"]:
        return [*changes, f"device {before.get('name')} -> {now['device']['name']}"]
    return changes + [f"{k} {before.get(k)} -> {value}" for k, value in now["device"].items() if before.get(k) != value]


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
