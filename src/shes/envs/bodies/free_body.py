"""Bodies with a free joint: heading, tilt, egocentric view, and the symmetry of their model."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from shes.envs.bodies.body import Body, ObservationElement, SymmetryGroup, elements, yaw
from shes.envs.bodies.find_symmetry import FoundSymmetry, find_symmetry
from shes.types import F64Array

Elements = tuple[ObservationElement, ...]


def free_elements(root: str, joints: Sequence[str], units: Sequence[str] = ()) -> tuple[Elements, Elements, Elements]:
    """Return the elements of qpos, qvel and the egocentric view of `root` with `joints`, in rad or in `units`."""
    each = list(zip(joints, units or ["rad"] * len(joints), strict=True))
    angles = tuple(elements([name], "angle of {}" if unit == "rad" else "{}", unit)[0] for name, unit in each)
    speeds = tuple(elements([f"{name}_velocity"], "{}", f"{unit}/s")[0] for name, unit in each)
    pose = (
        *elements([f"{root}_{axis}" for axis in "xyz"], "{} in the world", "m"),
        *(ObservationElement(name=f"{root}_q{i}", meaning=f"{i} of the {root}'s unit quaternion") for i in "wxyz"),
        *angles,
    )
    velocity = (
        *elements([f"{root}_v{axis}" for axis in "xyz"], "{}: velocity along a world axis", "m/s"),
        *elements(
            [f"{root}_w{axis}" for axis in "xyz"], f"{{}}: angular velocity about an axis of the {root}", "rad/s"
        ),
        *speeds,
    )
    egocentric = (
        pose[2],
        *elements(["tilt_ahead", "tilt_left"], f"{{}}: component of the {root}'s z axis"),
        *elements(["velocity_ahead", "velocity_left", "velocity_up"], f"{{}} of the {root}", "m/s"),
        *velocity[3:6],
        *angles,
        *speeds,
    )
    return pose, velocity, egocentric


class FreeBody(Body):
    """A root with a free joint, and joints of one coordinate each. qpos: x y z, quaternion w x y z, then the joints."""

    quaternion = slice(3, 7)
    _home_angles: Sequence[tuple[int, float]] = ()  # columns of the view, and what is 0 there

    def heading(self, qpos: F64Array) -> F64Array:
        """Return the angle [N] in the xy plane of the root's x axis, in radians."""
        return yaw(qpos[..., 3:7])

    def cos_tilt(self, qpos: F64Array) -> F64Array:
        """Return the vertical component [N] of the root's own z axis."""
        x, y = qpos[..., 4], qpos[..., 5]
        return 1 - 2 * (x * x + y * y)

    def frame_angle(self, qpos: F64Array) -> F64Array:
        """Return the twist of the root about the vertical [N] in radians.

        Deviation: not the heading. Seen from above, the x and y axes of a tilted root are not a quarter turn apart. The
        frame of the heading therefore violates a symmetry of quarter turns, to second order in the tilt.
        """
        return 2 * np.arctan2(qpos[:, 6], qpos[:, 3])

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write height, tilt, velocity, angular velocity and joints [N, 9 + 2 J]; see `Body.write_egocentric`.

        MuJoCo's angular velocity of a free joint is already in the root's frame. Joints are relative to the home pose.
        """
        cosine, sine = np.cos(angle), np.sin(angle)
        w, x, y, z = (qpos[:, i] for i in range(3, 7))
        end = 9 + qpos.shape[1] - 7
        out[:, 0] = qpos[:, 2]
        _turn_back(2 * (x * z + w * y), 2 * (y * z - w * x), cosine, sine, out[:, 1:3])
        _turn_back(qvel[:, 0], qvel[:, 1], cosine, sine, out[:, 3:5])
        out[:, 5:9] = qvel[:, 2:6]
        out[:, 9:end] = qpos[:, 7:]
        for column, zero in self._home_angles:  # one by one: a device has no array of them
            out[:, column] -= zero
        out[:, end:] = qvel[:, 6:]

    def symmetry(self, *, is_mirrored: bool) -> SymmetryGroup | None:
        """Return the rotations, and with `is_mirrored` the reflections, under which the model stays the same."""
        return self.found_symmetry().group(is_mirrored=is_mirrored)

    def found_symmetry(self) -> FoundSymmetry:
        """Return the symmetry of the body's model, as `find_symmetry` finds it."""
        model = self.alone()
        home = model.qpos0 if self.home is None else self.home
        return find_symmetry(model, home, self.control_map or (0.0, self.control_limit))

    def alone(self) -> mujoco.MjModel:
        """Return the model of the body without a world."""
        spec = mujoco.MjSpec()
        self.add_to(spec)
        return spec.compile()


def _turn_back(x: F64Array, y: F64Array, cosine: F64Array, sine: F64Array, out: F64Array) -> None:
    """Write the vectors (`x`, `y`) [N], rotated back by the angle of `cosine` and `sine`, into `out` [N, 2]."""
    np.add(cosine * x, sine * y, out=out[:, 0])
    np.subtract(cosine * y, sine * x, out=out[:, 1])
