"""The symmetry group of a robot's body: the rotations and reflections that map it onto itself.

A group element acts on the robot's egocentric view and on its controls by a signed permutation, so without rounding.

Source: Mittal et al. 2024 (symmetry in learned locomotion), sections II and III; `docs/learning.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shes.types import F64Array, IntArray

SYMMETRIES = ("none", "rotation", "dihedral")
"""Groups to choose from: `rotation` has the rotations, `dihedral` also the reflections."""


@dataclass(frozen=True, eq=False)
class SignedPermutation:
    """`new[i] = sign[i] * old[source[i]]`."""

    source: IntArray
    """Index of the value that each value comes from [V]."""
    sign: F64Array
    """+1 or -1 [V]."""

    def after(self, first: SignedPermutation) -> SignedPermutation:
        """Return the composition: `first`, then this permutation."""
        return SignedPermutation(first.source[self.source], self.sign * first.sign[self.source])

    def inverse(self) -> SignedPermutation:
        """Return the inverse permutation."""
        source = np.argsort(self.source)
        return SignedPermutation(source, self.sign[source])


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
    num_turns: int,
    turn: tuple[SignedPermutation, SignedPermutation],
    mirror: tuple[SignedPermutation, SignedPermutation],
    *,
    is_mirrored: bool,
) -> SymmetryGroup:
    """Return the group that a rotation, and with `is_mirrored` a reflection, generate.

    Args:
        num_turns: Order of the rotation, K.
        turn: Action of the rotation to the left by 1 / K of a turn, on the egocentric view and on the controls.
        mirror: Action of the reflection, left to right, on the two.
        is_mirrored: Whether the group contains the reflections.
    """

    def elements(turn: SignedPermutation, mirror: SignedPermutation) -> list[SignedPermutation]:
        """Return every element: the rotations, then the reflections."""
        turned = [SignedPermutation(np.arange(len(turn.source)), np.ones(len(turn.source)))]
        for _ in range(num_turns - 1):
            turned.append(turn.after(turned[-1]))
        return turned + ([mirror.after(element) for element in turned] if is_mirrored else [])

    views = elements(turn[0], mirror[0])
    inverses = [element.inverse() for element in elements(turn[1], mirror[1])]
    return SymmetryGroup(
        num_turns=num_turns,
        is_mirrored=is_mirrored,
        view_index=np.stack([each.source for each in views]),
        view_sign=np.stack([each.sign for each in views]),
        control_index=np.stack([each.source for each in inverses]),
        control_sign=np.stack([each.sign for each in inverses]),
    )
