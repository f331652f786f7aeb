"""Repetitions: runs that differ only in the seed, their own and those of the runs from which they have a level.

The path of such a run says nothing of what it is: each seed may have a primitive of its own. Its settings count
instead, and its planned length. The record of a run holds them. A shipped agent counts by its name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from shes.errors import ShesError
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.shipped import shipped_name

_LENGTHS = ("generations", "env_steps")


def repeated_settings(folder: RunFolder) -> dict[str, Any]:
    """Return the settings that repetitions of a run have in common, by name, as JSON types.

    Those of a run that trained the primitive are called `primitive's sigma`, and `primitive` is then `of ENV`.
    """
    return _settings(folder.read_config(), folder.read_record())


def seeds_of(folder: RunFolder) -> dict[str, int]:
    """Return the seeds in which repetitions of a run differ: `seed`, and `primitive's seed` if that is known."""
    return _seeds(folder.read_config(), folder.read_record())


def differing_settings(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of settings with more than one value among those of `settings` that have them."""
    names = dict.fromkeys(name for each in settings for name in each)
    values = {name: [each[name] for each in settings if name in each] for name in names}
    return [name for name, found in values.items() if any(value != found[0] for value in found)]


def origin_of(folder: RunFolder) -> dict[str, Any]:
    """Return what the record of a run keeps of `folder`, from which it has a level; nothing of a shipped agent."""
    if shipped_name(folder.path) is not None:
        return {}
    record, levels = folder.read_record(), folder.read_config().algorithm.transfers
    return {name: record[name] for name in ("config", *levels) if name in record}


def _settings(config: TrainConfig, record: Mapping[str, Any]) -> dict[str, Any]:
    found = {name: value for name, value in config.numbers().items() if name != "seed"}
    for level, (theirs, origin) in _sources(config, record).items():
        found[level] = f"of {theirs.run.env}"
        of_level = {**_settings(theirs, origin), **{name: getattr(theirs.run, name) for name in _LENGTHS}}
        found |= {f"{level}'s {name}": value for name, value in of_level.items() if name != "env"}
    return found


def _seeds(config: TrainConfig, record: Mapping[str, Any]) -> dict[str, int]:
    found = {"seed": config.run.seed}
    for level, source in _sources(config, record).items():
        found |= {f"{level}'s {name}": seed for name, seed in _seeds(*source).items()}
    return found


def _sources(config: TrainConfig, record: Mapping[str, Any]) -> dict[str, tuple[TrainConfig, Mapping[str, Any]]]:
    """Return settings and record of the runs from which a run has a level, by level, without those not known here."""
    found = {}
    for level in config.algorithm.transfers:
        origin = record.get(level)
        if isinstance(origin, Mapping) and "config" in origin:
            try:
                found[level] = TrainConfig.from_dict(origin["config"]), origin
            except (ShesError, TypeError, AttributeError):  # of a class that is not registered here, or edited by hand
                continue
    return found
