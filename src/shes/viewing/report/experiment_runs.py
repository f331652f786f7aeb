"""The runs of an experiment by their places in its folder, ENV/GROUP/VARIANT/seed-N, with names in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from shes.runs.folder import RunFolder
from shes.viewing.groups import Group, name_groups
from shes.viewing.report.experiment_design import Designs, read_designs

_SEED = "seed-"


@dataclass(frozen=True, kw_only=True)
class RunPlace:
    """The place of a run in an experiment."""

    env: str
    method: str
    """Its group and variant in words."""
    rank: int
    """Number of its method in the experiment."""
    seed: int

    @property
    def order(self) -> tuple[int, str, int]:
        """The order of runs: by method, environment and seed."""
        return self.rank, self.env, self.seed

    @property
    def name(self) -> str:
        """Name of the run in words."""
        return f"{self.env}: {self.method}, seed {self.seed}"


def place_runs(folders: Sequence[RunFolder], experiment: Path, prefix: str = "") -> dict[Path, RunPlace]:
    """Return the places of the runs of an experiment by their resolved paths; `prefix` begins every method."""
    try:
        designs = read_designs(experiment)
    except (OSError, ValueError):
        designs = Designs({})  # the section of the experiment says why
    found: dict[Path, tuple[str, str, str, int]] = {}
    for folder in folders:
        parts = folder.path.resolve().relative_to(experiment.resolve()).parts
        if len(parts) == 4 and parts[3].startswith(_SEED) and parts[3].removeprefix(_SEED).isdigit():
            env, group, variant, seed = parts
            found[folder.path.resolve()] = env, group, variant, int(seed.removeprefix(_SEED))
    others = sorted({(group, variant) for _, group, variant, _ in found.values()})
    ranks = {place: rank for rank, place in enumerate(dict.fromkeys([*designs.places, *others]))}
    return {
        path: RunPlace(env=env, method=prefix + designs.method(group, variant), rank=ranks[group, variant], seed=seed)
        for path, (env, group, variant, seed) in found.items()
    }


def group_places(folders: Sequence[RunFolder], places: Mapping[Path, RunPlace], others: Sequence[Group]) -> list[Group]:
    """Return the groups of runs of one method on one environment, then the `others`, which have other colours.

    A method has the same colour on all environments.
    """
    if not folders:
        return list(others)
    place_of = {folder.path: places[folder.path.resolve()] for folder in folders}
    by_rank = sorted(folders, key=lambda folder: place_of[folder.path].order)
    drawn = [(folder, place_of[folder.path].method) for folder in by_rank]
    # Numbered, because a label may be that of a method or of another one.
    drawn += [(folder, f"{number} {group.label}") for number, group in enumerate(others) for folder in group.folders]
    looks = name_groups([folder for folder, _ in drawn], [label for _, label in drawn])
    methods = looks[: len(looks) - len(others)]
    found: list[Group] = []
    for env in dict.fromkeys(place_of[folder.path].env for folder in by_rank):
        for group in methods:
            own = [folder for folder in group.folders if place_of[folder.path].env == env]
            if own:
                found.append(replace(group, folders=own, label=place_of[own[0].path].method))
    of_others = zip(looks[len(methods) :], others, strict=True)
    return [*found, *(replace(look, label=group.label) for look, group in of_others)]
