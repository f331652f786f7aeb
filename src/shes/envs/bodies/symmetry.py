"""The symmetry of a robot's body: the turns and mirrorings after which it looks the same.

An element of the group acts on the robot's egocentric view and on its controls by a signed permutation: every value
goes to another place, and some change their sign. No rounding is involved.

Source: learning specification, section 1; e.g. Mittal et al. 2024 (symmetry in locomotion), sections II and III.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shes.types import F64Array, IntArray

__all__ = ["SYMMETRIES", "SignedPermutation", "SymmetryGroup", "dihedral_group"]

SYMMETRIES = ("none", "rotation", "dihedral")
"""`rotation`: the turns that leave the body as it is; `dihedral`: these, and each of them mirrored."""


@dataclass(frozen=True, eq=False)
class SignedPermutation:
    """`new[i] = sign[i] * old[source[i]]`."""

    source: IntArray
    """Where each value comes from [V]."""
    sign: F64Array
    """+1 or -1 [V]."""

    def after(self, first: SignedPermutation) -> SignedPermutation:
        """Return the signed permutation that does `first`, then this one."""
        return SignedPermutation(first.source[self.source], self.sign * first.sign[self.source])

    def inverse(self) -> SignedPermutation:
        """Return the signed permutation that undoes this one."""
        source = np.argsort(self.source)
        return SignedPermutation(source, self.sign[source])


@dataclass(frozen=True, kw_only=True, eq=False)
class SymmetryGroup:
    """A group of K turns, or of these and their mirror images, T elements in all.

    Element k < K looks at the robot from a frame turned by k / K of a full turn to the left; element K + k then
    mirrors that frame, left for right.
    """

    num_turns: int
    """Turns in the group, K."""
    is_mirrored: bool
    """Whether mirror images belong to it."""
    view_index: IntArray
    """Where each value of the egocentric view comes from [T, V]."""
    view_sign: F64Array
    """Its sign [T, V]."""
    control_index: IntArray
    """Which control in the element's frame each control of the robot is [T, A]: what undoes the element."""
    control_sign: F64Array
    """Its sign [T, A]."""

    @property
    def num_elements(self) -> int:
        """Number of elements, T."""
        return len(self.view_index)

    def direction(self) -> tuple[F64Array, F64Array, F64Array]:
        """Return cosine and sine of every element's turn, and -1 for those that mirror, else 1, each [T]."""
        turns = np.arange(self.num_elements) % self.num_turns
        angle = 2 * np.pi * turns / self.num_turns
        cosine, sine = np.cos(angle), np.sin(angle)
        for part in (cosine, sine):  # quarter turns are exact: the cosine of half of pi is not quite 0
            part[np.abs(part) < 1e-9] = 0.0
        mirror = np.where(np.arange(self.num_elements) < self.num_turns, 1.0, -1.0)
        return cosine, sine, mirror

    def choose(self, ahead: F64Array, left: F64Array) -> IntArray:
        """Return the element [N] from whose frame goals at (`ahead`, `left`) [N] lie nearest to straight ahead.

        With mirror images the goal never lies to the right.
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
    """Return the group that a turn to the left by 1 / `num_turns`, and with `is_mirrored` a mirroring, generate.

    Args:
        num_turns: After so many turns everything is as before.
        turn: What the turn does to the egocentric view, and to the controls.
        mirror: The same of the mirroring, left for right.
        is_mirrored: Whether the mirror images belong to the group.
    """
    views, controls = (_elements(num_turns, turn[i], mirror[i], is_mirrored=is_mirrored) for i in range(2))
    back = [element.inverse() for element in controls]
    return SymmetryGroup(
        num_turns=num_turns,
        is_mirrored=is_mirrored,
        view_index=_stack(views)[0],
        view_sign=_stack(views)[1],
        control_index=_stack(back)[0],
        control_sign=_stack(back)[1],
    )


def _elements(
    num_turns: int, turn: SignedPermutation, mirror: SignedPermutation, *, is_mirrored: bool
) -> list[SignedPermutation]:
    """Return the signed permutation of every element: the turns, then each of them mirrored."""
    size = len(turn.source)
    turned = [SignedPermutation(np.arange(size), np.ones(size))]
    for _ in range(num_turns - 1):
        turned.append(turn.after(turned[-1]))
    return turned + ([mirror.after(element) for element in turned] if is_mirrored else [])


def _stack(elements: Sequence[SignedPermutation]) -> tuple[NDArray[np.int64], F64Array]:
    """Return sources and signs [T, V] of `elements`."""
    return np.stack([each.source for each in elements]), np.stack([each.sign for each in elements])
