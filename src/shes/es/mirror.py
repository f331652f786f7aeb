"""Mirrored sampling: the signs that the members of a group give to the group's noise vectors.

Source: SHES paper II-F. A group draws one noise vector per level, and its members differ only in their signs. The same
sign matrix determines the perturbations in the rollout and the signs of the ranks in the update.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.options import subclass_of
from shes.registry import Registry


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


def check_population(population_size: int, mirrored: str, num_levels: int) -> int:
    """Return the number of mirrored groups G in a population; raise ConfigError unless they are whole."""
    members = len(sign_matrix(mirrored, num_levels))
    if population_size <= 0 or population_size % members:
        lower = max(members, population_size - population_size % members)
        raise ConfigError(
            f"population_size must be a positive multiple of {members}, the size of a group with {mirrored!r} "
            f"mirroring when {num_levels} level{'s are' if num_levels > 1 else ' is'} perturbed, got "
            f"{population_size}. Set --population-size {lower} or {lower + members}."
        )
    return population_size // members
