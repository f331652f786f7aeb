"""Images of an ant in a rotated or reflected world, from its model's geometry alone, not from the body's tables.

A world is rotated about the vertical, or reflected (y -> -y), by an orthogonal matrix S. The ant's symmetry T maps its
body onto itself and every leg onto another: an ant of pose R in the first world looks like one of pose S R T^-1, with
permuted legs, in the second.
"""

import mujoco
import numpy as np


def turned(angle):
    """Return the rotation [3, 3] about the vertical by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def quarters(number):
    """Return the exact rotation by `number` quarter turns to the left."""
    return np.rint(turned(number * np.pi / 2))


MIRROR = np.diag([1.0, -1.0, 1.0])
ELEMENTS = tuple(quarters(k) @ mirror for mirror in (np.eye(3), MIRROR) for k in range(4))
"""The symmetry of the ant's body: four turns to the left, and each of them after a mirroring."""


def images_of_hinges(model, element):
    """Return which hinge of `model` each one is the image of under `element`, and whether it turns the other way."""
    hinges = [joint for joint in range(model.njnt) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # all legs stretched, the torso upright: places and axes are the torso's
    places, axes = data.xanchor[hinges] - data.xpos[model.body("torso").id], data.xaxis[hinges]
    # An axis of rotation is a pseudovector.
    there, around = places @ element.T, np.linalg.det(element) * axes @ element.T
    is_image = np.isclose(places[:, None], there).all(axis=2) & np.isclose(np.abs(axes @ around.T), 1)
    assert (is_image.sum(axis=1) == 1).all()
    source = is_image.argmax(axis=1)
    return source, np.rint((axes @ around.T)[range(len(hinges)), source])


class Images:
    """Images of states, controls and goals of `model`, an ant whose hinges follow its free joint in qpos and qvel."""

    def __init__(self, model, world, element):
        """Map by `world` [3, 3] and the body's `element` [3, 3]: both rotations or both reflections."""
        assert np.isclose(np.linalg.det(world), np.linalg.det(element))
        self.model, self.world, self.element = model, world, element
        self.source, self.sign = images_of_hinges(model, element)

    def qpos(self, qpos):
        rotation, quaternion = np.zeros(9), np.zeros(4)
        mujoco.mju_quat2Mat(rotation, qpos[3:7])
        mujoco.mju_mat2Quat(quaternion, (self.world @ rotation.reshape(3, 3) @ self.element.T).ravel())
        return np.concatenate([self.world @ qpos[:3], quaternion, self._hinge(qpos[7:])])

    def qvel(self, qvel):
        """Return the image of velocities or accelerations."""
        # MuJoCo gives the torso's rotation about its own axes: a pseudovector.
        spin = np.linalg.det(self.element) * self.element @ qvel[3:6]
        return np.concatenate([self.world @ qvel[:3], spin, self._hinge(qvel[6:])])

    def ctrl(self, ctrl):
        joints = [self.model.joint(self.model.actuator(i).trnid[0]).qposadr[0] - 7 for i in range(self.model.nu)]
        by_hinge = np.zeros(len(joints))
        by_hinge[joints] = ctrl
        return self._hinge(by_hinge)[joints]

    def point(self, place):
        """Return the image of a position or direction on the ground [2]."""
        return self.world[:2, :2] @ place

    def _hinge(self, values):
        return self.sign * values[self.source]
