"""Perturbation: which levels the members of a generation perturb, and with which signs.

A group draws one noise vector per level, and its members differ only in their signs: +1, -1, or 0 for a level at its
mean policy. The same signs determine the perturbations in the rollout and the signs of the fitness in the update.

Source: SHES paper II-E (many-to-many, one-to-many) and II-F (mirroring).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F32Array, F64Array

Signs: TypeAlias = NDArray[np.int8]
"""Signs [G, M, L] of every member of a population at each level."""


class Mirroring(ABC):
    """How the members of a group mirror its noise."""

    @abstractmethod
    def rows(self, num_levels: int) -> Sequence[Sequence[int]]:
        """Return the signs of each member, +1 or -1 at every level."""


class Quad(Mirroring):
    """Every combination of signs. With one level it is a pair, as in S-ES."""

    def rows(self, num_levels: int) -> Sequence[Sequence[int]]:
        """Return (+,+), (+,-), (-,+), (-,-) with two levels."""
        return list(product((1, -1), repeat=num_levels))


class Pair(Mirroring):
    """All plus and all minus."""

    def rows(self, num_levels: int) -> Sequence[Sequence[int]]:
        """Return two opposite members."""
        return (1,) * num_levels, (-1,) * num_levels


class Unmirrored(Mirroring):
    """A single member."""

    def rows(self, num_levels: int) -> Sequence[Sequence[int]]:
        """Return one member."""
        return ((1,) * num_levels,)


MIRRORINGS: Registry[type[Mirroring]] = Registry(
    "mirroring",
    {"quad": Quad, "pair": Pair, "none": Unmirrored},
    fix="Set --mirrored.",
    check=subclass_of(Mirroring),
)
"""Mirrorings by name: the choices of `--mirrored`."""


def sign_matrix(mirrored: str, num_levels: int) -> NDArray[np.int8]:
    """Return the signs [M, L], each +1 or -1, of the members of one mirrored group.

    Raises:
        UnknownNameError: `mirrored` is not one of `MIRRORINGS`.
    """
    return np.array(MIRRORINGS.find(mirrored)().rows(num_levels), dtype=np.int8)


class Perturbation(ABC):
    """Chooses the sign of every member's perturbation at each level."""

    @abstractmethod
    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the signs [G, M, L] of G groups of M members: +1, -1, or 0 where a level is not perturbed.

        Args:
            generation: Number of updates so far.
            population_size: Number of members, n = G * M.
            mirrored: How the members of a group mirror its noise: one of `MIRRORINGS`.
            learns: Whether each level learns. A level that does not is never perturbed.

        Raises:
            ConfigError: The population size does not fit the group size.
            UnknownNameError: `mirrored` is not known.
        """


class ManyToMany(Perturbation):
    """Every member perturbs both levels. Source: SHES paper II-E, its default."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the same signs in every generation."""
        levels = np.flatnonzero(learns)
        members = sign_matrix(mirrored, len(levels))
        perturbed = f"{len(levels)} level{'s are' if len(levels) > 1 else ' is'} perturbed"
        _check_multiple(
            population_size, len(members), f"the size of a group with {mirrored!r} mirroring when {perturbed}"
        )
        signs = np.zeros((population_size // len(members), len(members), len(learns)), dtype=np.int8)
        signs[:, :, levels] = members
        return signs


class OneToMany(Perturbation):
    """Generations alternate between perturbing the controller and the primitive. Source: SHES paper II-E."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return signs for the level whose turn it is."""
        levels = np.flatnonzero(learns).tolist()
        return _one_level(levels[generation % len(levels)], population_size, mirrored, len(learns))


class OneToManyHalves(Perturbation):
    """Half of the members perturb the controller, the other half the primitive. Source: SHES paper II-E."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the signs of the controller's half, then the signs of the primitive's half."""
        levels = np.flatnonzero(learns).tolist()
        members = len(sign_matrix(mirrored, 1))
        group = f"a group of {members} with {mirrored!r} mirroring for each level that learns"
        _check_multiple(population_size, len(levels) * members, group)
        share = population_size // len(levels)
        return np.concatenate([_one_level(level, share, mirrored, len(learns)) for level in levels])


def _one_level(level: int, population_size: int, mirrored: str, num_levels: int) -> Signs:
    return ManyToMany().signs(0, population_size, mirrored, [i == level for i in range(num_levels)])


def _check_multiple(population_size: int, members: int, group: str) -> None:
    if population_size <= 0 or population_size % members:
        lower = max(members, population_size - population_size % members)
        raise ConfigError(
            f"population_size must be a positive multiple of {members}, {group}, got {population_size}. "
            f"Set --population-size {lower} or {lower + members}."
        )


PERTURBATIONS: Registry[type[Perturbation]] = Registry(
    "perturbation",
    {"many_to_many": ManyToMany, "one_to_many": OneToMany, "one_to_many_halves": OneToManyHalves},
    fix="Set --perturbation.",
    check=subclass_of(Perturbation),
)
"""Perturbations by name: the choices of `--perturbation`."""


def group_weights(shaped: F64Array, signs: NDArray[np.int8]) -> F32Array:
    """Return one weight [G] per noise vector: the signed sum of the members' shaped fitness.

    Args:
        shaped: Shaped fitness [n] of the population, group after group.
        signs: Signs [G, M] of each group's members at one level.
    """
    values = shaped.reshape(signs.shape)
    # Sorted, so that equal values on both sides cancel exactly. Optimizers that ignore the gradient's length would take
    # a rounding error for a direction.
    plus, minus = (np.sort(np.where(side, values, 0.0), axis=1).sum(axis=1) for side in (signs > 0, signs < 0))
    return (plus - minus).astype(np.float32)
