"""Perturbation: which levels the members of a generation perturb, and with which signs.

A group draws one noise vector per level, and its members differ only in their signs: +1, -1, or 0 for a level at its
mean policy. Rollout and update use the same signs.

Source: SHES paper II-E (many-to-many, one-to-many) and II-F (mirroring).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.registry import Registry, check_function

Signs: TypeAlias = NDArray[np.int8]
"""Signs [G, M, L] of every member of a population at each level."""


Mirroring: TypeAlias = Callable[[int], Sequence[Sequence[int]]]
"""A function of the number of levels that returns the signs of each member of a group, +1 or -1 at every level."""


def quad(num_levels: int) -> Sequence[Sequence[int]]:
    """Every combination of signs. With one level it is a pair, as in S-ES."""
    return list(product((1, -1), repeat=num_levels))


def pair(num_levels: int) -> Sequence[Sequence[int]]:
    """All plus and all minus."""
    return (1,) * num_levels, (-1,) * num_levels


def unmirrored(num_levels: int) -> Sequence[Sequence[int]]:
    """A single member."""
    return ((1,) * num_levels,)


MIRRORINGS: Registry[Mirroring] = Registry(
    "mirroring", {"quad": quad, "pair": pair, "none": unmirrored}, fix="Set --mirrored.", check=check_function
)
"""Mirrorings by name: the choices of `--mirrored`."""


Perturbation: TypeAlias = Callable[[int, Sequence[int]], Sequence[Sequence[int]]]
"""A function of the number of updates so far and the levels that learn.

It returns the levels that each of one or more equal parts of the population perturbs, as many in each part.
"""


def many_to_many(_generation: int, levels: Sequence[int]) -> Sequence[Sequence[int]]:
    """Every member perturbs both levels. Source: SHES paper II-E, its default."""
    return [levels]


def one_to_many(generation: int, levels: Sequence[int]) -> Sequence[Sequence[int]]:
    """Generations alternate between perturbing the controller and the primitive. Source: SHES paper II-E."""
    return [[levels[generation % len(levels)]]]


def one_to_many_halves(_generation: int, levels: Sequence[int]) -> Sequence[Sequence[int]]:
    """Half of the members perturb the controller, the other half the primitive. Source: SHES paper II-E."""
    return [[level] for level in levels]


PERTURBATIONS: Registry[Perturbation] = Registry(
    "perturbation",
    {"many_to_many": many_to_many, "one_to_many": one_to_many, "one_to_many_halves": one_to_many_halves},
    fix="Set --perturbation.",
    check=check_function,
)
"""Perturbations by name: the choices of `--perturbation`."""


def member_signs(
    perturbation: str, mirrored: str, population_size: int, learns: Sequence[bool], generation: int
) -> Signs:
    """Return the signs [G, M, L] of G groups of M members: +1, -1, or 0 where a level is not perturbed.

    Args:
        perturbation: One of `PERTURBATIONS`.
        mirrored: How the members of a group mirror its noise: one of `MIRRORINGS`.
        population_size: Number of members, n = G * M, which `check_population_size` allows.
        learns: Whether each level learns. A level that does not is never perturbed.
        generation: Number of updates so far.
    """
    parts = PERTURBATIONS.find(perturbation)(generation, np.flatnonzero(learns).tolist())
    rows = MIRRORINGS.find(mirrored)(len(parts[0]))
    signs = np.zeros((population_size // len(rows), len(rows), len(learns)), dtype=np.int8)
    for levels, part in zip(parts, np.split(signs, len(parts)), strict=True):
        part[:, :, levels] = rows
    return signs


def check_population_size(perturbation: str, mirrored: str, population_size: int, learns: Sequence[bool]) -> None:
    """Raise ConfigError unless the members fill whole groups; nothing of the population's size is allocated."""
    parts = PERTURBATIONS.find(perturbation)(0, np.flatnonzero(learns).tolist())
    whole = len(parts) * len(MIRRORINGS.find(mirrored)(len(parts[0])))
    if population_size <= 0 or population_size % whole:
        each = " for each level that learns" if len(parts) > 1 else ""
        lower = max(whole, population_size - population_size % whole)
        raise ConfigError(
            f"population_size must be a positive multiple of {whole}, a group with {mirrored!r} mirroring{each}, got "
            f"{population_size}. Set --population-size {lower} or {lower + whole}."
        )
