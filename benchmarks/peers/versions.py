"""Versions of the packages that are compared, and the machine, written next to the results of a script."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from run import write_csv

from shes.runs.folder import provenance

PACKAGES = ("shes", "torch", "stable-baselines3", "evotorch", "ray", "gymnasium", "mujoco", "numpy")


def write_versions(path: Path) -> None:
    """Write the versions of the packages, and the machine, to a CSV file."""
    found = provenance("cpu")
    versions = {name: version(name) for name in PACKAGES}
    rows = {"commit of shes": found["git_commit"], **versions, **found["machine"]}
    write_csv(path, [{"name": name, "value": value} for name, value in rows.items()])
