"""Versions of the packages that are compared, and the machine, written next to the results of a script."""

from __future__ import annotations

from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from run import write_csv

from shes.runs.folder import provenance

PACKAGES = ("shes", "torch", "stable-baselines3", "evotorch", "ray", "gymnasium", "mujoco", "numpy")


def write_versions(path: Path) -> None:
    """Write the versions of the packages, and the machine, to a CSV file."""
    found = provenance("cpu")
    versions = dict[str, str]()
    for name in PACKAGES:
        with suppress(PackageNotFoundError):  # of a learner that did not run
            versions[name] = version(name)
    rows = {"commit of shes": found["git_commit"], **versions, **found["machine"]}
    write_csv(path, [{"name": name, "value": value} for name, value in rows.items()])
