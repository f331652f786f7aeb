"""The symmetry group of a robot's body: the rotations and reflections that map it onto itself.

A group element acts on the robot's egocentric view and on its controls by a signed permutation, so without rounding.

Source: Mittal et al. 2024 (symmetry in learned locomotion), sections II and III; `docs/learning.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.types import F64Array, IntArray

SYMMETRIES = ("none", "rotation", "dihedral")
"""Groups to choose from: `rotation` has the rotations, `dihedral` also the reflections."""


def signed_permutation(source: Sequence[int], sign: Sequence[float]) -> F64Array:
    """Return the matrix [V, V] of `new[i] = sign[i] * old[source[i]]`."""
    return np.eye(len(source))[list(source)] * np.array(sign)[:, None]


@dataclass(frozen=True, kw_only=True, eq=False)
class SymmetryGroup:
    """A group of K rotations, or of K rotations and K reflections: T elements.

    Element k < K expresses the robot's state in a frame rotated to the left by k / K of a full turn. Element K + k also
    reflects that frame, left to right.
    """

    num_turns: int
    """Number of rotations, K."""
    is_mirrored: bool
    """Whether the group contains the reflections."""
    view_index: IntArray
    """Index of the value that each value of the egocentric view comes from [T, V]."""
    view_sign: F64Array
    """Sign of each value of the egocentric view [T, V]."""
    control_index: IntArray
    """Index of the control in the element's frame that each control of the robot comes from [T, A]: the inverse."""
    control_sign: F64Array
    """Sign of each control [T, A]."""

    @property
    def num_elements(self) -> int:
        """Number of elements, T."""
        return len(self.view_index)

    def direction(self) -> tuple[F64Array, F64Array, F64Array]:
        """Return cosine and sine of every element's rotation, and -1 for reflections, else 1; each [T]."""
        turns = np.arange(self.num_elements) % self.num_turns
        angle = 2 * np.pi * turns / self.num_turns
        cosine, sine = np.cos(angle), np.sin(angle)
        for part in (cosine, sine):  # make quarter turns exact: np.cos(np.pi / 2) is not 0
            part[np.abs(part) < 1e-9] = 0.0
        mirror = np.where(np.arange(self.num_elements) < self.num_turns, 1.0, -1.0)
        return cosine, sine, mirror

    def choose(self, ahead: F64Array, left: F64Array) -> IntArray:
        """Return the element [N] in whose frame goals at (`ahead`, `left`) [N] are nearest to straight ahead.

        With reflections the goal is never to the right.
        """
        turn = np.arctan2(left, ahead) * (self.num_turns / (2 * np.pi))
        nearest = np.rint(turn)
        element = nearest.astype(np.int64) % self.num_turns
        if self.is_mirrored:
            element += self.num_turns * (turn < nearest).astype(np.int64)
        return element


def dihedral_group(
    num_turns: int, turn: tuple[F64Array, F64Array], mirror: tuple[F64Array, F64Array], *, is_mirrored: bool
) -> SymmetryGroup:
    """Return the group that a rotation, and with `is_mirrored` a reflection, generate.

    Args:
        num_turns: Order of the rotation, K.
        turn: Signed permutations of the rotation to the left by 1 / K of a turn: of the egocentric view [V, V] and of
            the controls [A, A].
        mirror: Signed permutations of the reflection, left to right.
        is_mirrored: Whether the group contains the reflections.
    """
    views, controls = (
        np.stack([flip @ np.linalg.matrix_power(turned, k) for flip in flips for k in range(num_turns)])
        for turned, flips in ((turn[i], [np.eye(len(turn[i])), mirror[i]][: 1 + is_mirrored]) for i in (0, 1))
    )
    inverses = controls.transpose(0, 2, 1)
    return SymmetryGroup(
        num_turns=num_turns,
        is_mirrored=is_mirrored,
        view_index=np.abs(views).argmax(axis=2),
        view_sign=views.sum(axis=2),
        control_index=np.abs(inverses).argmax(axis=2),
        control_sign=inverses.sum(axis=2),
    )
