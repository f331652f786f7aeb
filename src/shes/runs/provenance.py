"""The provenance of a run: time, command, versions, machine."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from shes.runs.device import device_facts

_PACKAGES = ("shes", "mujoco", "numpy")


def provenance(device: str, packages: Iterable[str] = ()) -> dict[str, Any]:
    """Return the provenance of a run of this process on `device`, as JSON types.

    Its versions are those of the packages that every run uses, and of those of `packages` that are installed.
    """
    versions = {name: _version(name) for name in _PACKAGES}
    for name in packages:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = _version(name)
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "versions": {"python": platform.python_version(), **versions},
        "git_commit": _git_commit(),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "device": device_facts(device),
    }


@cache
def _version(package: str) -> str:
    return metadata.version(package)


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
