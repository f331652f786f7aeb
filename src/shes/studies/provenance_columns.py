"""The provenance of results: hardware, versions and commits, as columns of text. See `shes.runs.provenance`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from shes.runs.tables import Row

PROVENANCE = ("hardware", "versions", "commit")


def provenance_columns(parts: Sequence[Mapping[str, Any]]) -> Row:
    """Return the columns `PROVENANCE` of a run with these parts, each with the provenance of one process."""
    return {
        "hardware": joined(_hardware(part) for part in parts),
        "versions": joined(_facts(part.get("versions", {})) for part in parts),
        "commit": joined(part.get("git_commit") for part in parts),
    }


def joined(texts: Iterable[str | None]) -> str | None:
    """Return the different ones of `texts`, which may themselves be joined; None if there is none."""
    found = dict.fromkeys(each for text in texts if text for each in text.split("; "))
    return "; ".join(found) or None


def _hardware(part: Mapping[str, Any]) -> str:
    machine, device = part.get("machine", {}), part.get("device", {})
    gpu = "" if device.get("name") in (None, "cpu") else f", {_facts(device)}"
    return f"{machine.get('processor')}, {machine.get('cores')} cores{gpu}"


def _facts(facts: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items())
