"""Mirrored sampling: the signs that the members of a group give to the group's noise vectors.

Source: SHES paper II-F. A group draws one noise vector per level, and its members differ only in their signs. The same
sign matrix determines the perturbations in the rollout and the signs of the ranks in the update.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError, UnknownNameError

MIRRORINGS = ("quad", "pair", "none")
"""`quad`: every combination of signs; `pair`: all plus and all minus; `none`: no mirroring."""


def sign_matrix(mirrored: str, num_levels: int) -> NDArray[np.int8]:
    """Return the signs [M, L], each +1 or -1, of the members of one mirrored group.

    With two levels `quad` is (+,+), (+,-), (-,+), (-,-). With one level `quad` and `pair` are both +, -, as in S-ES.

    Raises:
        UnknownNameError: `mirrored` is not one of `MIRRORINGS`.
    """
    if mirrored not in MIRRORINGS:
        raise UnknownNameError("mirroring", mirrored, MIRRORINGS, "Set --mirrored.")
    if mirrored == "quad":
        rows = list(product((1, -1), repeat=num_levels))
    else:
        rows = [(sign,) * num_levels for sign in ((1, -1) if mirrored == "pair" else (1,))]
    return np.array(rows, dtype=np.int8)


def check_population(population_size: int, mirrored: str, num_levels: int) -> int:
    """Return the number of mirrored groups G in a population; raise ConfigError unless they are whole."""
    members = len(sign_matrix(mirrored, num_levels))
    if population_size <= 0 or population_size % members:
        lower = max(members, population_size - population_size % members)
        raise ConfigError(
            f"population_size must be a positive multiple of {members} with {mirrored!r} mirroring and {num_levels} "
            f"level(s), got {population_size}. Set --population-size {lower} or {lower + members}."
        )
    return population_size // members
