"""Images of an ant in a turned or mirrored world: from its model's geometry alone, not from the tables it comes with.

A world is turned about the vertical, or mirrored (y -> -y), by an orthogonal matrix S. The ant's own symmetry T maps
its body to itself, every leg to another one: an ant of pose R in the first world looks like one of pose S R T^-1 in the
second one, whose legs have each other's names.
"""

from dataclasses import dataclass

import mujoco
import numpy as np


def turned(angle):
    """Return the rotation [3, 3] about the vertical by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def quarters(number):
    """Return the rotation by a `number` of quarter turns to the left: exact."""
    return np.rint(turned(number * np.pi / 2))


MIRROR = np.diag([1.0, -1.0, 1.0])
ELEMENTS = tuple(quarters(k) @ mirror for mirror in (np.eye(3), MIRROR) for k in range(4))
"""The symmetry of the ant's body: four turns to the left, and each of them after a mirroring."""


@dataclass(frozen=True)
class Hinges:
    """What becomes of a model's hinges under one element of its symmetry."""

    source: np.ndarray
    """Which hinge each one is the image of."""
    sign: np.ndarray
    """Whether it turns the other way."""


def images_of_hinges(model, element):
    """Return what `element` makes of the hinges of `model`: places and axes of the legs say it."""
    hinges = [joint for joint in range(model.njnt) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # all legs stretched, the torso upright: places and axes are the torso's
    places = data.xanchor[hinges] - data.xpos[model.body("torso").id]
    axes = data.xaxis[hinges]
    source, sign = [], []
    for place, axis in zip(places, axes, strict=True):
        # An axis of rotation is a pseudovector.
        there, around = places @ element.T, np.linalg.det(element) * axes @ element.T
        (found,) = [
            i for i in range(len(hinges)) if np.allclose(there[i], place) and np.isclose(abs(around[i] @ axis), 1)
        ]
        source.append(found)
        sign.append(np.rint(around[found] @ axis))
    return Hinges(np.array(source), np.array(sign))


class Images:
    """Images of states, controls and goals of `model`, a floating ant whose hinges come after it in qpos and qvel."""

    def __init__(self, model, world, element):
        """Look at `world` [3, 3] through the body's `element` [3, 3]: both turn, or both mirror."""
        assert np.isclose(np.linalg.det(world), np.linalg.det(element))
        self.model, self.world, self.element = model, world, element
        self.hinges = images_of_hinges(model, element)

    def qpos(self, qpos):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, qpos[3:7])
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, (self.world @ rotation.reshape(3, 3) @ self.element.T).ravel())
        return np.concatenate([self.world @ qpos[:3], quaternion, self._hinge(qpos[7:])])

    def qvel(self, qvel):
        """Return the image of velocities, or of accelerations."""
        # MuJoCo gives the torso's rotation about its own axes: a pseudovector.
        spin = np.linalg.det(self.element) * self.element @ qvel[3:6]
        return np.concatenate([self.world @ qvel[:3], spin, self._hinge(qvel[6:])])

    def ctrl(self, ctrl):
        joints = [self.model.joint(self.model.actuator(i).trnid[0]).qposadr[0] - 7 for i in range(self.model.nu)]
        by_hinge = np.zeros(len(joints))
        by_hinge[joints] = ctrl
        return self._hinge(by_hinge)[joints]

    def point(self, place):
        """Return the image of a place or direction on the ground [2]."""
        return self.world[:2, :2] @ place

    def _hinge(self, values):
        return self.hinges.sign * values[self.hinges.source]
