"""Finds the symmetry group of a body from its joints, and proves it by the physics.

A candidate maps every joint's anchor and axis to those of a joint of the same kind. It counts if random states, mapped
in this way, have mapped accelerations. Source: own design; `docs/robots.md`, *Symmetry*.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from shes.envs.bodies.body import SymmetryGroup, dihedral_group
from shes.types import F64Array

TOLERANCE = 0.02
"""Largest median difference of accelerations of mapped states, relative to their size; a robot is never quite even.

Also the largest distance of a mapped anchor from its partner's, relative to the body's extent, and of moments.
"""
TURNS = (8, 7, 6, 5, 4, 3, 2)
"""Orders of rotation that are tried, the highest first."""
_NUM_STATES = 20
_AXIS_COSINE = 0.99


@dataclass(frozen=True, kw_only=True)
class Element:
    """A rotation about the vertical or a reflection of a body, as it acts on a `FreeBody`."""

    matrices: tuple[F64Array, F64Array]
    """How it acts on the egocentric view [V, V], and on controls [A, A]: a signed permutation."""
    residual: float
    """Median difference of accelerations, relative to their size."""


@dataclass(frozen=True, kw_only=True)
class FoundSymmetry:
    """The symmetry of a body: the highest order of rotation, and the reflection left to right."""

    num_turns: int
    turn: Element | None
    mirror: Element | None

    def group(self, *, is_mirrored: bool) -> SymmetryGroup | None:
        """Return the group, with the reflection if `is_mirrored` and there is one; None for the identity alone."""
        mirror = self.mirror if is_mirrored else None
        known = self.turn or mirror
        if known is None:
            return None
        return dihedral_group(self.num_turns, known.matrices, mirror and mirror.matrices)


def find_symmetry(
    model: mujoco.MjModel, home: F64Array, control_map: tuple[F64Array | float, F64Array | float]
) -> FoundSymmetry:
    """Return the symmetry of a body alone in `model`, whose first joint is free.

    `home` is its pose; offset and factor in `control_map` make controls of those in [-1, 1] that the symmetry maps.
    """
    body = _Kinematics(model, home, control_map)
    turns = ((num, found) for num in TURNS if (found := body.element(_rotation(-2 * np.pi / num))) is not None)
    num_turns, turn = next(turns, (1, None))
    return FoundSymmetry(num_turns=num_turns, turn=turn, mirror=body.element(np.diag([1.0, -1.0, 1.0])))


def _rotation(angle: float) -> F64Array:
    """Return the matrix [3, 3] of a rotation about the vertical; quarter turns are exact."""
    cosine, sine = (0.0 if abs(x) < 1e-9 else float(x) for x in (np.cos(angle), np.sin(angle)))
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])


def _block_diagonal(*blocks: F64Array) -> F64Array:
    ends = np.cumsum([len(block) for block in blocks])
    matrix = np.zeros((ends[-1], ends[-1]))
    for end, block in zip(ends.tolist(), blocks, strict=True):
        matrix[end - len(block) : end, end - len(block) : end] = block
    return matrix


class _Kinematics:
    """Anchors, axes and actuators of a body in its home pose, upright at the origin."""

    def __init__(self, model: mujoco.MjModel, home: F64Array, control_map: tuple[Any, Any]) -> None:
        self.model, self.data, self.control_map = model, mujoco.MjData(model), control_map
        self.home = np.array([0, 0, 100, 1, 0, 0, 0, *home[7:]])
        self.data.qpos[:] = self.home
        mujoco.mj_forward(model, self.data)
        self.anchors, self.axes = self.data.xanchor[1:] - self.data.qpos[:3], self.data.xaxis[1:].copy()
        moment: Any = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moment, self.data.actuator_moment, self.data.moment_rownnz, self.data.moment_rowadr, self.data.moment_colind
        )
        self.moment = moment[:, 6:]

    def element(self, rotation: F64Array) -> Element | None:
        """Return how the body is mapped onto itself by `rotation` [3, 3]; None if it is not."""
        joints = self._joints(rotation)
        if joints is None:
            return None
        # Actuators follow their joints: one whose moments, mapped, are those of another up to the sign is its partner.
        mapped = (self.moment @ joints.T)[:, None]
        both = np.array([np.abs(self.moment - sign * mapped).max(axis=2, initial=0.0) for sign in (1, -1)])
        near = TOLERANCE * np.abs(self.moment).max(initial=1e-9)
        controls = _signed_permutation(both.min(axis=0), np.where(both[0] <= both[1], 1.0, -1.0), near)
        if controls is None:
            return None
        spin = np.linalg.det(rotation).round() * rotation
        residual = self._residual(_block_diagonal(rotation, spin, joints), controls)
        view = _block_diagonal(np.eye(1), rotation[:2, :2], rotation, spin, joints, joints)
        return Element(matrices=(view, controls), residual=residual) if residual <= TOLERANCE else None

    def _joints(self, rotation: F64Array) -> F64Array | None:
        """Return the signed permutation of the joints [J, J], or None if a joint has no partner of its own."""
        kinds = self.model.jnt_type[1:]
        # An axis of rotation is a pseudovector.
        factor = np.where(kinds == mujoco.mjtJoint.mjJNT_HINGE, np.linalg.det(rotation), 1.0)
        cosine = self.axes @ rotation.T * factor[:, None] @ self.axes.T
        distance = np.linalg.norm((self.anchors @ rotation.T)[:, None] - self.anchors, axis=2)
        distance[(np.abs(cosine) < _AXIS_COSINE) | (kinds[:, None] != kinds)] = np.inf
        near = TOLERANCE * max(np.ptp(self.anchors, axis=0).max(initial=0.0), 0.1)
        return _signed_permutation(distance, np.sign(cosine), near)

    def _residual(self, mapping: F64Array, controls: F64Array) -> float:
        """Return the median relative difference of accelerations of states and their images by `mapping` [nv, nv]."""
        rng = np.random.default_rng(0)
        model, data, (middle, half) = self.model, self.data, self.control_map
        has_state = model.actuator_actnum == 1

        def accelerations(tilt: F64Array, offset: F64Array, qvel: F64Array, ctrl: F64Array) -> F64Array:
            mujoco.mj_resetData(model, data)
            data.qpos[:] = self.home
            data.qpos[3:7] = np.array([1.0, *tilt]) / np.sqrt(1 + tilt @ tilt)
            data.qpos[7:] += offset
            data.qvel[:], data.ctrl[:] = qvel, middle + half * ctrl
            data.act[model.actuator_actadr[has_state]] = data.ctrl[has_state]
            mujoco.mj_forward(model, data)
            return data.qacc.copy()

        differences = list[float]()
        for _ in range(_NUM_STATES):
            tilt, offset = rng.normal(0, 0.3, 3), rng.normal(0, 0.1, model.nv - 6)
            qvel, swing = rng.normal(0, 1.0, model.nv), rng.uniform(-0.5, 0.5, model.nu)
            image = mapping @ accelerations(tilt, offset, qvel, swing)
            found = accelerations(mapping[3:6, 3:6] @ tilt, mapping[6:, 6:] @ offset, mapping @ qvel, controls @ swing)
            differences.append(float(np.linalg.norm(image - found) / np.linalg.norm(image)))
        return float(np.median(differences))


def _signed_permutation(distance: F64Array, sign: F64Array, near: float) -> F64Array | None:
    """Return the matrix [V, V] that moves value i to the nearest free place j, times `sign` [i, j].

    None means that a value has no free place nearer than `near`, by `distance` [i, j].
    """
    matrix = np.zeros(distance.shape)
    for i, row in enumerate(distance):
        j = np.where(matrix.any(axis=1), np.inf, row).argmin()
        if matrix[j].any() or row[j] > near:
            return None
        matrix[j, i] = sign[i, j]
    return matrix
