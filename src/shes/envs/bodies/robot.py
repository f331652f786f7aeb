"""A robot from its MJCF file: its joints, actuators, home pose, size, and the rule by which it has fallen.

Source: own design; `docs/robots.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import mujoco
import numpy as np

from shes.envs.bodies.body import MIN_COS_TILT, Body, add_motor
from shes.envs.bodies.free_body import FreeBody, free_elements
from shes.envs.bodies.robot_file import RobotFile, compiled, read_robot
from shes.envs.worlds import CELL_SIZE_M
from shes.errors import ConfigError
from shes.settings import Example, Ge, Gt, Le, Settings, Shown
from shes.types import BoolArray, F64Array

ANT_EXTENT_M = 1.873
"""Largest extent of the ant's legs along x or y: the size that worlds, distances and rewards are made for."""
ANT_MASS_KG = 0.911
_MIN_HEIGHT = 0.5  # of the home pose, below which it has fallen
_FREE_SERVO = 0.5  # rad or m of a position servo without any limit
_MAX_JOINTS, _MIN_M, _MAX_M, _MAX_KG = 200, 0.01, 100.0, 1e5
_MAX_STEPS = 1000  # physics steps in a control step: one call, which nothing interrupts
_PREFIX = "robot/"
_OPTIONS = ("timestep", "integrator", "cone", "impratio", "solver", "iterations", "tolerance")
_OPTIONS += ("noslip_iterations", "gravity")
"""The options of the physics that a robot's file decides."""


@dataclass(frozen=True, kw_only=True)
class RobotOptions(Settings):
    """The robot and how it is driven."""

    robot: Annotated[str, Shown(everyday=True), Example("robot.xml")] | None = None
    """Robot: its MJCF file; menagerie:NAME (extra robots); or ant or point, which come with SHES."""
    motors: Annotated[float | None, Gt(0)] = None
    """Largest torque of a motor at each joint, for a robot whose file has no actuators."""
    control_step: Annotated[float, Ge(0.001), Le(0.2)] = 0.02
    """Seconds of a control step, rounded to physics steps of the file."""
    robot_keyframe: str | None = None
    """Keyframe of the file that is the home pose; none is the first one, or without one the initial pose."""


class Robot(FreeBody):
    """A robot with a free joint, from its file. A policy's controls lie in [-1, 1]; see `control_map`."""

    Options = RobotOptions
    options: RobotOptions  # type: ignore[assignment] - narrower than in Body
    control_unit = "1"
    control_limit = 1.0
    velocity_clip = 100.0

    def __init__(self, options: Settings | None = None, file: RobotFile | None = None) -> None:
        """Read the robot of `options`, from `file` if it is given; raise ConfigError if it cannot be driven."""
        super().__init__(options)
        self.file = file or read_robot(self.options.robot)
        self.name = self.file.name
        model = self.alone()
        self.timestep_s = float(model.opt.timestep)
        home, extent = self._home_pose(model)
        self.home, self._height = home, float(home[2])
        self.mass_kg = float(model.body_subtreemass[0])
        self._check(model, home, extent)
        root = _name(model.body(1)) or "root"
        kinds = ["rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m" for kind in model.jnt_type[1:]]
        joints = [_name(model.joint(i)) or f"joint_{i}" for i in range(1, model.njnt)]
        self.pose, self.velocity, self.egocentric = free_elements(root, joints, kinds)
        self.controls = tuple(_name(model.actuator(i)) or f"control_{i}" for i in range(model.nu))
        self.frame_skip = round(self.options.control_step / self.timestep_s)
        self._home_angles = [(9 + i, angle) for i, angle in enumerate(home[7:].tolist()) if angle]
        self.scale = float(f"{extent / ANT_EXTENT_M:.2g}")
        self.block_factor = self.mass_kg / ANT_MASS_KG
        self.control_map, self.home_activation = self._driven(model)

    def _check(self, model: mujoco.MjModel, home: F64Array, extent: float) -> None:
        """Raise ConfigError if `model`, the robot alone, cannot be driven or has no plausible size."""
        joints, step, own_step = model.njnt - 1, self.options.control_step, self.timestep_s
        size = f"{extent:.3g} m large and weighs {self.mass_kg:.3g} kg"
        sizes = f"{_MIN_M:g} to {_MAX_M:g} m and up to {_MAX_KG:g} kg"
        has_size = _MIN_M < extent < _MAX_M and 0 < self.mass_kg < _MAX_KG and np.isfinite(home).all()
        is_upright = self.cos_tilt(home) >= MIN_COS_TILT
        problems = {
            "has ball joints, which a policy here cannot observe. Use hinges.": model.nq != model.nv + 1,
            f"has {joints} joints besides its root, not 1 to {_MAX_JOINTS}.": not 0 < joints <= _MAX_JOINTS,
            "has no actuators. Add some to its file, or set --motors N (torque).": not model.nu,
            f"has a physics step of {own_step:g} s, but control_step is {step:g} s. Set --control-step to 1 to "
            f"{_MAX_STEPS} times it, or correct the file.": not step / _MAX_STEPS <= own_step <= step,
            f"is {size}, not {sizes}. Check its units: metres and kilograms.": not has_size,
            "lies in its home pose: its root tilts by more than 60 degrees. "
            "Choose another pose with --robot-keyframe.": not is_upright,
        }
        for problem in (text for text, is_found in problems.items() if is_found):
            raise ConfigError(f"robot {self.name!r} {problem}")

    @classmethod
    def maker(cls, options: Settings) -> Callable[[], Body]:
        """Return a function that makes the robot anywhere, also where its file is not."""
        return partial(cls, options, read_robot(options.robot))  # type: ignore[attr-defined] - of class RobotOptions

    def as_drawn(self) -> Body:
        """Return the robot as it looks, with the shapes that its physics does not need."""
        drawn = copy(self)
        drawn.file = self.file._replace(physics=self.file.content)
        return drawn

    def _parts(self) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
        """Return the robot's spec with the options' motors, and its root: the free body with most joints."""
        spec, torque = self.file.spec(), self.options.motors
        kinds = {body: [joint.type for joint in body.joints] for body in spec.worldbody.bodies}
        free = [body for body, own in kinds.items() if mujoco.mjtJoint.mjJNT_FREE in own]
        if not free:
            raise ConfigError(f"robot {self.name!r} has no body with a free joint. Add <freejoint/> to its root body.")
        root = max(free, key=lambda body: len(body.find_all("joint")))
        if torque is None:
            return spec, root
        if len(spec.actuators):
            raise ConfigError(f"robot {self.name!r} has actuators of its own. Omit --motors.")
        names = {joint.name for joint in spec.joints}
        for number, joint in enumerate(root.find_all("joint")):
            if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                name = joint.name or f"joint_{number}"
                while not joint.name and name in names:
                    name += "_"
                joint.name = name
                add_motor(spec, joint.name, torque)
        return spec, root

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the robot with its actuators to `spec`, and the physics of its file."""
        child, root = self._parts()
        for part in [*child.keys, *child.sensors, *child.lights, *child.cameras]:
            child.delete(part)
        for name in _OPTIONS:
            setattr(spec.option, name, getattr(child.option, name))
        spec.assets = child.assets
        child.nkey = spec.nkey  # MuJoCo warns where the two specs differ
        child.visual.map.znear, child.visual.map.zfar = spec.visual.map.znear, spec.visual.map.zfar
        for name in dir(spec):
            if name.startswith("nuser_") or name in ("njmax", "nconmax", "nstack", "memory"):
                setattr(child, name, getattr(spec, name))
        spec.worldbody.add_frame(pos=[0, 0, ground_m]).attach_body(root, _PREFIX, "")

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether the root tilts by more than 60 degrees, or is lower than half its height at home [N]."""
        is_low = qpos[..., 2] - ground_m < _MIN_HEIGHT * self._height
        return is_low | (self.cos_tilt(qpos) < MIN_COS_TILT)

    def describe(self) -> dict[str, str]:
        """Return what was understood of the file, in words."""
        home, control_map, found = self.home, self.control_map, self.found_symmetry()
        assert home is not None, "the constructor sets it"
        assert control_map is not None, "the constructor sets it"
        turns = "none" if found.turn is None else f"{found.num_turns} turns (difference {found.turn.residual:.1e})"
        mirror = "no mirror" if found.mirror is None else f"mirror (difference {found.mirror.residual:.1e})"
        step = self.frame_skip * self.timestep_s
        return {
            "root": f"{self.pose[0].name.removesuffix('_x')}, {len(self.pose) - 7} joints, {self.mass_kg:.3g} kg",
            "home pose": f"{self._height:.3g} m high; joints " + " ".join(f"{angle:.3g}" for angle in home[7:]),
            "actuators": ", ".join(
                f"{name} {offset:.3g} ± {factor:.3g}"
                for name, offset, factor in zip(self.controls, *control_map, strict=True)
            ),
            "time": f"physics step {self.timestep_s:g} s, control step {step:g} s",
            "fallen": f"tilt above 60 degrees, or lower than {_MIN_HEIGHT * self._height:.3g} m",
            "symmetry": f"{turns}, {mirror}",
            "size": f"{self.scale:g} of the ant's: cells of {CELL_SIZE_M * self.scale:g} m",
        }

    def _home_pose(self, model: mujoco.MjModel) -> tuple[F64Array, float]:
        """Return the home pose [num_qpos] at the origin, lifted onto the ground, and the robot's extent in metres."""
        spec, root = self._parts()
        whole, data = compiled(spec), mujoco.MjData(model)
        names, wanted = [whole.key(i).name for i in range(whole.nkey)], self.options.robot_keyframe
        if wanted is not None and wanted not in names:
            known = f"its keyframes: {', '.join(names)}" if names else "it has none"
            raise ConfigError(f"robot {self.name!r} has no keyframe {wanted!r} ({known}). Change --robot-keyframe.")
        pose = whole.key_qpos[0 if wanted is None else names.index(wanted)] if names else whole.qpos0
        first = whole.jnt_qposadr[whole.body_jntadr[root.id]]
        home = pose[first : first + model.nq].copy()
        home[:2] = 0
        data.qpos[:] = home
        mujoco.mj_kinematics(model, data)
        low, high = self._bounds(model, data)
        home[2] -= low[2]
        return home, float((high - low).max())

    def _bounds(self, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64Array, F64Array]:
        """Return the corners [3] of a box around what collides, in the pose of `data`."""
        collides = ((model.geom_contype | model.geom_conaffinity) & 1).astype(bool) & (model.geom_bodyid > 0)
        if not collides.any():
            raise ConfigError(
                f"nothing of robot {self.name!r} collides with the floor (contype 1). Let its feet do so."
            )
        turn = data.geom_xmat[collides].reshape(-1, 3, 3)
        centre, half = model.geom_aabb[collides, :3], model.geom_aabb[collides, 3:]
        middle = data.geom_xpos[collides] + (turn @ centre[:, :, None])[:, :, 0]
        reach = (np.abs(turn) @ half[:, :, None])[:, :, 0]
        return (middle - reach).min(axis=0), (middle + reach).max(axis=0)

    def _driven(self, model: mujoco.MjModel) -> tuple[tuple[F64Array, F64Array], F64Array | None]:
        """Return offset and factor [A] of controls (0 holds the home pose, ±1 is far), and its activations, if any."""
        data = mujoco.MjData(model)
        data.qpos[:] = self.home
        mujoco.mj_forward(model, data)
        pairs = [self._range(model, i, float(data.actuator_length[i])) for i in range(model.nu)]
        offset, factor = np.array(pairs).T
        activation = np.zeros(model.na)
        for i in np.flatnonzero(model.actuator_actnum == 1):
            gain, (_, stiffness, _) = model.actuator_gainprm[i, 0], model.actuator_biasprm[i, :3]
            kind, place = mujoco.mjtDyn(model.actuator_dyntype[i]), model.actuator_actadr[i]
            if kind in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):  # it follows the control
                activation[place] = offset[i]
            elif kind == mujoco.mjtDyn.mjDYN_INTEGRATOR and stiffness and gain:  # it is the position of a servo
                activation[place] = -stiffness / gain * data.actuator_length[i]
        return (offset, factor), activation if model.na else None

    def _range(self, model: mujoco.MjModel, i: int, length: float) -> tuple[float, float]:
        """Return offset and factor of actuator `i`, whose joint or tendon has this `length` at home."""
        gain, (_, stiffness, damping) = float(model.actuator_gainprm[i, 0]), model.actuator_biasprm[i, :3]
        low, high = model.actuator_ctrlrange[i].tolist() if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
        has_bias = model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
        is_rate = model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        if has_bias and stiffness and gain and not is_rate:  # a position servo
            center, joint = -stiffness / gain * length, int(model.actuator_trnid[i, 0])
            is_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            if not np.isfinite(low) and is_joint and model.jnt_limited[joint]:
                low, high = np.sort(model.jnt_range[joint] * model.actuator_gear[i, 0] * -stiffness / gain).tolist()
            if not np.isfinite(low):
                return center, _FREE_SERVO
            center = min(max(center, low), high)
            return center, max(min(high - center, center - low) / 2, (high - low) / 10)
        if not np.isfinite(low) and model.actuator_forcelimited[i] and gain:
            low, high = (model.actuator_forcerange[i] / abs(gain)).tolist()
        if not np.isfinite(low):
            kind = "velocity servo" if is_rate or (has_bias and damping) else "motor"
            raise ConfigError(
                f"actuator {self.controls[i]!r} of robot {self.name!r}, a {kind}, has no ctrlrange and no forcerange. "
                "Give it one in the file."
            )
        return (low + high) / 2, (high - low) / 2


def _name(part: object) -> str:
    """Return the name of a body, joint or actuator in the robot's file."""
    return part.name.removeprefix(_PREFIX)  # type: ignore[attr-defined] - MuJoCo has no common type of them
