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
from shes.types import F64Array, IntArray

TOLERANCE = 0.02
"""Largest median difference of accelerations of mapped states, relative to their size; a robot is never quite even."""
ANCHOR_TOLERANCE = 0.02
"""Largest distance of a mapped anchor from its partner's, as a fraction of the body's extent."""
TURNS = (8, 7, 6, 5, 4, 3, 2)
"""Orders of rotation that are tried, the highest first."""
_NUM_STATES = 20
_AXIS_COSINE = 0.99


@dataclass(frozen=True, kw_only=True)
class Element:
    """A rotation about the vertical or a reflection of a body, as it acts on joints and actuators."""

    rotation: F64Array
    """The matrix [3, 3]."""
    joint_source: IntArray
    """Joint that each joint's coordinate comes from [J]."""
    joint_sign: F64Array
    """Sign of each joint's coordinate [J]."""
    control_source: IntArray
    """Actuator that each actuator's control comes from [A]."""
    control_sign: F64Array
    """Sign of each actuator's control [A]."""
    residual: float
    """Median difference of accelerations, relative to their size."""

    @property
    def matrices(self) -> tuple[F64Array, F64Array]:
        """How it acts on the egocentric view [V, V] of a `FreeBody` and on its controls [A, A]."""
        num_joints = len(self.joint_source)
        view = np.zeros((9 + 2 * num_joints,) * 2)
        turn, spin = self.rotation, np.linalg.det(self.rotation).round() * self.rotation
        view[0, 0], view[1:3, 1:3], view[3:6, 3:6], view[6:9, 6:9] = 1, turn[:2, :2], turn, spin
        joints = np.eye(num_joints)[self.joint_source] * self.joint_sign[:, None]
        view[9 : 9 + num_joints, 9 : 9 + num_joints] = view[9 + num_joints :, 9 + num_joints :] = joints
        controls = np.eye(len(self.control_source))[self.control_source] * self.control_sign[:, None]
        return view, controls


@dataclass(frozen=True, kw_only=True)
class FoundSymmetry:
    """The symmetry of a body: the highest order of rotation, and the reflection left to right."""

    num_turns: int
    turn: Element | None
    mirror: Element | None

    def group(self, *, is_mirrored: bool) -> SymmetryGroup | None:
        """Return the group, with the reflection if `is_mirrored` and there is one; None for the identity alone."""
        mirror = self.mirror if is_mirrored else None
        if self.turn is None and mirror is None:
            return None
        known = self.turn or mirror
        assert known is not None
        identity = tuple(np.eye(len(each)) for each in known.matrices)
        return dihedral_group(
            self.num_turns,
            self.turn.matrices if self.turn else (identity[0], identity[1]),
            mirror.matrices if mirror else (identity[0], identity[1]),
            is_mirrored=mirror is not None,
        )


def find_symmetry(
    model: mujoco.MjModel, home: F64Array | None = None, control_map: tuple[F64Array, F64Array] | None = None
) -> FoundSymmetry:
    """Return the symmetry of a body alone in `model`, whose first joint is free.

    `home` is its pose if not qpos0; `control_map` as in `Body` makes controls that the symmetry is to map.
    """
    body = _Kinematics(model, home, control_map)
    turns = ((num, found) for num in TURNS if (found := body.element(_rotation(-2 * np.pi / num))) is not None)
    num_turns, turn = next(turns, (1, None))
    return FoundSymmetry(num_turns=num_turns, turn=turn, mirror=body.element(np.diag([1.0, -1.0, 1.0])))


def _rotation(angle: float) -> F64Array:
    """Return the matrix [3, 3] of a rotation about the vertical; quarter turns are exact."""
    cosine, sine = (0.0 if abs(x) < 1e-9 else float(x) for x in (np.cos(angle), np.sin(angle)))
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])


class _Kinematics:
    """Anchors, axes and actuators of a body in its home pose, upright at the origin."""

    def __init__(
        self, model: mujoco.MjModel, home: F64Array | None, control_map: tuple[F64Array, F64Array] | None
    ) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        limited = model.actuator_ctrllimited.astype(bool)
        half = np.where(limited, np.ptp(model.actuator_ctrlrange, axis=1) / 2, 1.0)
        self.control_map = control_map or (model.actuator_ctrlrange.mean(axis=1), half)
        self.home = np.array(model.qpos0 if home is None else home)
        self.home[:7] = (0, 0, 100, 1, 0, 0, 0)
        self.data.qpos[:] = self.home
        mujoco.mj_forward(model, self.data)
        self.anchors = self.data.xanchor[1:] - self.data.qpos[:3]
        self.axes = self.data.xaxis[1:].copy()
        self.kinds = model.jnt_type[1:]
        moment: Any = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moment, self.data.actuator_moment, self.data.moment_rownnz, self.data.moment_rowadr, self.data.moment_colind
        )
        self.moment = moment[:, 6:]

    def element(self, rotation: F64Array) -> Element | None:
        """Return how the body is mapped onto itself by `rotation`; None if it is not."""
        joints = self._joints(rotation)
        if joints is None:
            return None
        # Actuators follow their joints: one whose moments, mapped, are those of another up to the sign is its partner.
        mapped = np.zeros_like(self.moment)
        mapped[:, np.arange(len(joints[0]))] = self.moment[:, joints[0]] * joints[1]
        controls = _partners(mapped, self.moment)
        if controls is None:
            return None
        # `mapped` row i equals, up to its sign, the row of the actuator that i becomes: i is the source of that one.
        source = np.argsort(controls[0])
        residual = self._residual(rotation, joints, (source, controls[1][source]))
        if not residual <= TOLERANCE:
            return None
        return Element(
            rotation=rotation,
            joint_source=joints[0],
            joint_sign=joints[1],
            control_source=source,
            control_sign=controls[1][source],
            residual=residual,
        )

    def _joints(self, rotation: F64Array) -> tuple[IntArray, F64Array] | None:
        """Return source and sign of each joint's coordinate, or None if a joint has no partner of its own."""
        anchors = self.anchors @ rotation.T
        factor = np.where(self.kinds == mujoco.mjtJoint.mjJNT_HINGE, np.linalg.det(rotation), 1.0)
        axes = self.axes @ rotation.T * factor[:, None]
        near = ANCHOR_TOLERANCE * max(np.ptp(self.anchors, axis=0).max(initial=0.0), 0.1)
        source, sign = np.full(len(anchors), -1), np.ones(len(anchors))
        for i, (anchor, axis) in enumerate(zip(anchors, axes, strict=True)):
            cosine = self.axes @ axis
            signs = np.sign(cosine)
            distance = np.linalg.norm(self.anchors - anchor, axis=1)
            fits = (np.abs(cosine) > _AXIS_COSINE) & (distance < near) & (self.kinds == self.kinds[i])
            free = np.flatnonzero(fits & (source < 0))
            if not len(free):
                return None
            partner = free[distance[free].argmin()]
            source[partner], sign[partner] = i, signs[partner]
        return source, sign

    def _residual(self, rotation: F64Array, joints: Any, controls: Any) -> float:
        """Return the median relative difference between accelerations of random states and of their images."""
        rng = np.random.default_rng(0)
        model, data = self.model, self.data
        spin = np.linalg.det(rotation) * rotation

        def image(vector: F64Array) -> F64Array:
            """Return velocities or accelerations [nv] of the mapped body."""
            return np.concatenate([rotation @ vector[:3], spin @ vector[3:6], vector[6:][joints[0]] * joints[1]])

        def accelerations(qpos: F64Array, qvel: F64Array, ctrl: F64Array) -> F64Array:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, middle + half * ctrl
            data.act[model.actuator_actadr[has_state]] = data.ctrl[has_state]
            mujoco.mj_forward(model, data)
            return data.qacc.copy()

        middle, half = self.control_map
        has_state = model.actuator_actnum == 1
        differences = list[float]()
        for _ in range(_NUM_STATES):
            tilt = rng.normal(0, 0.3, 3)
            quaternion = np.array([1.0, *tilt]) / np.sqrt(1 + tilt @ tilt)
            offset, qvel = rng.normal(0, 0.1, len(joints[0])), rng.normal(0, 1.0, model.nv)
            swing = rng.uniform(-0.5, 0.5, model.nu)
            home = self.home[7:]
            qpos = np.concatenate([self.home[:3], quaternion, home + offset])
            turned = np.concatenate([quaternion[:1], spin @ quaternion[1:]])
            mapped = np.concatenate([self.home[:3], turned, home + offset[joints[0]] * joints[1]])
            before = accelerations(qpos, qvel, swing)
            after = accelerations(mapped, image(qvel), swing[controls[0]] * controls[1])
            differences.append(float(np.linalg.norm(image(before) - after) / np.linalg.norm(before)))
        return float(np.median(differences))


def _partners(mapped: F64Array, rows: F64Array) -> tuple[IntArray, F64Array] | None:
    """Return for each of `mapped` [A, J] the one of `rows` [A, J] that it equals up to the sign, and the sign."""
    partner, sign = list[int](), list[float]()
    size = np.abs(rows).max(initial=1e-9)
    for row in mapped:
        both = [(np.abs(rows - s * row).max(axis=1, initial=0.0), s) for s in (1.0, -1.0)]
        distance, s = min(both, key=lambda each: each[0].min(initial=np.inf))
        best = int(distance.argmin())
        if distance[best] > 0.02 * size or best in partner:
            return None
        partner.append(best)
        sign.append(s)
    return np.array(partner, dtype=np.int64), np.array(sign)
