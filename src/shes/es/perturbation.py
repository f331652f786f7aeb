"""Perturbation: which levels the members of a generation perturb.

Source: SHES paper II-E (many-to-many, one-to-many) and II-F (mirroring). The same signs determine the perturbations in
the rollout and the signs of the fitness in the update. The sign 0 leaves a level at its mean policy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.es.mirror import check_population, sign_matrix
from shes.options import subclass_of
from shes.registry import Registry

Signs: TypeAlias = NDArray[np.int8]
"""Signs [G, M, L] of every member of a population at each level."""


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
        groups = check_population(population_size, mirrored, len(levels))
        members = sign_matrix(mirrored, len(levels))
        signs = np.zeros((groups, len(members), len(learns)), dtype=np.int8)
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
        """Return the signs of the controller's half, then those of the primitive's."""
        levels = np.flatnonzero(learns).tolist()
        group = len(sign_matrix(mirrored, 1))
        least = len(levels) * group
        if population_size <= 0 or population_size % least:
            lower = max(least, population_size - population_size % least)
            raise ConfigError(
                f"population_size must be a positive multiple of {least}, a group of {group} with {mirrored!r} "
                f"mirroring for each level that learns, got {population_size}. "
                f"Set --population-size {lower} or {lower + least}."
            )
        share = population_size // len(levels)
        return np.concatenate([_one_level(level, share, mirrored, len(learns)) for level in levels])


def _one_level(level: int, population_size: int, mirrored: str, num_levels: int) -> Signs:
    """Return the signs [G, M, L] of members that perturb only `level`."""
    return ManyToMany().signs(0, population_size, mirrored, [i == level for i in range(num_levels)])


PERTURBATIONS: Registry[type[Perturbation]] = Registry(
    "perturbation",
    {"many_to_many": ManyToMany, "one_to_many": OneToMany, "one_to_many_halves": OneToManyHalves},
    fix="Set --perturbation.",
    check=subclass_of(Perturbation),
)
"""Perturbations by name: the choices of `--perturbation`."""
