"""Which levels a generation perturbs: both at once, or one while the other stays the mean policy.

Source: SHES paper II-E (many-to-many, one-to-many) and II-F (mirroring). One array of signs says everything, to the
rollout (which perturbation) and to the update (which sign a fitness gets): 0 leaves a level as it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.es.mirror import check_population, sign_matrix
from shes.registry import Registry, subclass_of

__all__ = [
    "PERTURBATIONS",
    "ManyToMany",
    "OneToMany",
    "OneToManyHalves",
    "Perturbation",
    "Signs",
    "check_perturbation",
    "make_perturbation",
]

Signs = NDArray[np.int8]
"""Signs [G, M, L] of every member of a population at each level."""


class Perturbation(ABC):
    """Says which signs the members of a population give to the noise of each level."""

    @abstractmethod
    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the signs [G, M, L] of G groups of M members: +1, -1, or 0 for a level that is not perturbed.

        Args:
            generation: Updates made so far.
            population_size: Members in all, n = G * M.
            mirrored: How the members of a group mirror its noise.
            learns: For each level, whether it learns at all; one that does not is never perturbed.

        Raises:
            ConfigError: The population is not a multiple of what a group, or a share of it, needs.
            UnknownNameError: `mirrored` is not known.
        """


class ManyToMany(Perturbation):
    """Every member has a perturbed controller and a perturbed primitive (paper II-E, the default)."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the same signs in every generation."""
        del generation
        levels = np.flatnonzero(learns)
        groups = check_population(population_size, mirrored, len(levels))
        members = sign_matrix(mirrored, len(levels))
        signs = np.zeros((groups, len(members), len(learns)), dtype=np.int8)
        signs[:, :, levels] = members
        return signs


class OneToMany(Perturbation):
    """Generations take turns: in one the controller is perturbed, in the next the primitive (paper II-E)."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the signs of the level whose turn it is."""
        levels = np.flatnonzero(learns)
        turn = [i == levels[generation % len(levels)] for i in range(len(learns))]
        return ManyToMany().signs(generation, population_size, mirrored, turn)


class OneToManyHalves(Perturbation):
    """Half of a generation perturbs the controller, the other half the primitive (paper II-E)."""

    def signs(self, generation: int, population_size: int, mirrored: str, learns: Sequence[bool]) -> Signs:
        """Return the signs of the controller's half, then of the primitive's."""
        levels = np.flatnonzero(learns)
        least = len(levels) * len(sign_matrix(mirrored, 1))
        if population_size <= 0 or population_size % least:
            lower = max(least, population_size - population_size % least)
            raise ConfigError(
                f"population_size must be a positive multiple of {least} with {mirrored!r} mirroring and a share of it "
                f"for each of {len(levels)} level(s), got {population_size}. "
                f"Set --population-size {lower} or {lower + least}."
            )
        share = population_size // len(levels)
        parts = [
            ManyToMany().signs(generation, share, mirrored, [i == level for i in range(len(learns))])
            for level in levels
        ]
        return np.concatenate(parts)


PERTURBATIONS: Registry[type[Perturbation]] = Registry(
    "perturbation",
    {
        "many_to_many": ManyToMany,
        "one_to_many": OneToMany,
        "one_to_many_halves": OneToManyHalves,
    },
    fix="Set --perturbation.",
    check=subclass_of(Perturbation),
)


def check_perturbation(name: str, population_size: int, mirrored: str, learns: Sequence[bool]) -> None:
    """Refuse what `name` cannot do with such a population.

    Raises:
        UnknownNameError: `name` is not in `PERTURBATIONS`.
        ConfigError: The population does not fit.
    """
    make_perturbation(name).signs(0, population_size, mirrored, learns)


def make_perturbation(name: str) -> Perturbation:
    """Return the perturbation of this name.

    Raises:
        UnknownNameError: `name` is not in `PERTURBATIONS`.
    """
    return PERTURBATIONS.find(name)()
