"""A robot from its MJCF file: its joints, actuators, home pose, size, and the rule by which it has fallen.

Source: own design; `docs/robots.md`.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import lru_cache, partial
from hashlib import sha256
from html import unescape
from pathlib import Path, PurePosixPath
from typing import Annotated, NamedTuple

import mujoco
import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.bodies.free_body import FreeBody, free_elements
from shes.errors import ConfigError
from shes.settings import Example, Ge, Gt, Le, Settings, Shown
from shes.sim.simulator import log_physics_warnings
from shes.types import BoolArray, F64Array

MENAGERIE = "menagerie:"
"""Prefix of the name of a robot in the package mujoco-menagerie."""
ANT_EXTENT_M = 1.873
"""Largest extent of the ant's legs along x or y: the size that worlds, distances and rewards are made for."""
ANT_MASS_KG = 0.911
MAX_TILT = 60.0
"""Degrees beyond which a robot has fallen."""
_MIN_COS_TILT = float(np.cos(np.deg2rad(MAX_TILT)))
_MIN_HEIGHT = 0.5  # of the home pose, below which it has fallen
_FREE_SERVO = 0.5  # rad or m of a position servo without any limit
_MAX_JOINTS, _MAX_BYTES, _MAX_CLIP = 200, 200_000_000, 100.0
_MAX_STEPS = 1000  # physics steps in a control step: one call, which nothing interrupts
_PREFIX = "robot/"
_FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
_PHYSICS = (
    "timestep",
    "integrator",
    "cone",
    "impratio",
    "solver",
    "iterations",
    "tolerance",
    "noslip_iterations",
    "gravity",
)
_MAX_DEPTH = 20
_MIN_M, _MAX_M, _MAX_KG = 0.01, 100.0, 1e5
_NAMING = re.compile(r"<(include|model|flexcomp)\b.*?\bfile\s*=\s*([\"'])(.*?)\2", re.DOTALL)
"""The elements with which XML reads a file before it is checked."""
_FIX = "Check the file with `python -m mujoco.viewer --mjcf FILE`."


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


class RobotFile(NamedTuple):
    """A robot's file with all that it names, as zip archives, which can be sent and kept in a run folder."""

    name: str
    content: bytes
    """Everything, to draw the robot."""
    physics: bytes
    """What its physics needs: all but visual shapes and sensors."""

    @property
    def label(self) -> str:
        """Name, and the first digits of the SHA-256 of its content: two files of one name may be two robots."""
        return f"{self.name} ({sha256(self.content).hexdigest()[:8]})"


def _spec_of(packed: bytes) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_zip(io.BytesIO(packed))


def read_robot(robot: str | None) -> RobotFile:
    """Return the robot that `robot` names: a file, an archive of a run folder, or `menagerie:NAME`."""
    if not robot:
        raise ConfigError("which robot? Set --robot to its MJCF file, to menagerie:NAME, or to ant or point.")
    path = _from_menagerie(robot) if robot.startswith(MENAGERIE) else Path(robot)
    with suppress(RuntimeError):  # there is no such user
        path = path.expanduser()
    if not path.is_file():
        raise ConfigError(f"robot {robot!r} is no file. Set --robot to an MJCF file, menagerie:NAME, ant or point.")
    if path.stat().st_size > _MAX_BYTES:
        raise ConfigError(f"robot {robot!r} has {path.stat().st_size / 1e6:,.0f} MB, more than {_MAX_BYTES / 1e6:.0f}.")
    return _read(path, robot_stem(robot), path.stat().st_mtime_ns)


def robot_stem(robot: str) -> str:
    """Return the name of the file `robot`, or of a robot of the Menagerie, as a file's name without its ending."""
    return PurePosixPath(robot.replace(":", "-").replace("\\", "/")).stem


@lru_cache(maxsize=4)
def _read(path: Path, name: str, _changed: int) -> RobotFile:
    """Read the robot `name` from the file at `path`, anew if that has changed."""
    if path.suffix == ".zip":
        content = path.read_bytes()
    else:
        spec = _parsed(path)
        _compiled(spec, name)
        content = _zipped(spec)
    spec = _unzipped(content, path)  # XML of MuJoCo is rounded: the physics is the same from the file and from its copy
    _reduce_to_physics(spec, _compiled(spec, name))
    return RobotFile(name, content, _zipped(spec))


def _unzipped(content: bytes, path: Path) -> mujoco.MjSpec:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            size = sum(each.file_size for each in packed.infolist())
            texts = [packed.read(name) for name in packed.namelist() if name.endswith(".xml") and size <= _MAX_BYTES]
        if size > _MAX_BYTES:
            raise ConfigError(f"it has more than {_MAX_BYTES / 1e6:.0f} MB of files")
        if any(_NAMING.search(text.decode(errors="replace")) for text in texts):
            raise ConfigError("its XML includes other files")
        spec = _spec_of(content)
        if missing := [name for name in _files(spec) if name not in spec.assets]:
            raise ConfigError(f"it lacks the file {missing[0]!r}")
    except (ValueError, OSError, NotImplementedError, RuntimeError, zipfile.BadZipFile, mujoco.FatalError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(f"robot {str(path)!r} cannot be read: {words}. Give an archive of a run folder.") from error
    return spec


def _from_menagerie(robot: str) -> Path:
    try:
        import mujoco_menagerie  # type: ignore[import-not-found] - an extra
    except ImportError as error:
        raise ConfigError(f"robot {robot!r} needs the package mujoco-menagerie: pip install 'shes[robots]'.") from error
    name = robot.removeprefix(MENAGERIE)
    try:
        found = mujoco_menagerie.get(name)
    except mujoco_menagerie.UnknownRobotError as error:
        raise ConfigError(
            f"MuJoCo Menagerie has no robot {name!r} ({error}). Its names: mujoco_menagerie.names()."
        ) from error
    try:
        return found.xml()
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise ConfigError(
            f"robot {robot!r} cannot be downloaded: {error}. Check the network, or give a file."
        ) from error


def _parsed(path: Path) -> mujoco.MjSpec:
    """Return the spec of the file at `path` with the files that it names; raise ConfigError if it is not sound."""
    log_physics_warnings()
    try:
        _check_includes(path, path.parent)
        with warnings.catch_warnings(action="ignore"):
            spec = mujoco.MjSpec.from_file(str(path))
            files = {name: _inside(path.parent / name, path.parent) for name in _files(spec)}
        if sum(file.stat().st_size for file in files.values()) > _MAX_BYTES:
            raise ConfigError(f"it has more than {_MAX_BYTES / 1e6:.0f} MB of files")
        spec.assets = {name: file.read_bytes() for name, file in files.items()}
    except (ValueError, OSError, RecursionError, mujoco.FatalError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(f"robot {str(path)!r} cannot be read: {words}. {_FIX}") from error
    return spec


def _files(spec: mujoco.MjSpec) -> list[str]:
    """Return the paths of the files that `spec` names, relative to its own folder."""
    named = [(spec.meshdir, each.file) for each in (*spec.meshes, *spec.hfields, *spec.skins)]
    named += [(spec.texturedir, file) for each in spec.textures for file in (each.file, *each.cubefiles)]
    return list(dict.fromkeys(str(PurePosixPath(folder) / file) for folder, file in named if file))


def _zipped(spec: mujoco.MjSpec) -> bytes:
    """Return an archive of `spec` with the files that it names alone; `MjSpec.to_zip` writes all it once had."""
    packed, names = io.BytesIO(), _files(spec)
    try:
        with warnings.catch_warnings(action="ignore"):
            text = spec.to_xml()
    except UnicodeDecodeError as error:
        raise ConfigError(f"a name in the robot's file is not UTF-8: {error.object!r}. Save it as UTF-8.") from error
    with zipfile.ZipFile(packed, "w") as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(name), spec.assets[name])
        archive.writestr(zipfile.ZipInfo("robot.xml"), text)
    return packed.getvalue()


def _reduce_to_physics(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Remove from `spec`, of which `model` was compiled, what the physics does not need."""
    for body in spec.bodies[1:]:
        own = model.body(body.id)
        body.explicitinertial, body.mass, body.inertia = True, own.mass[0], own.inertia
        body.ipos, body.iquat = own.ipos, own.iquat
    for part in [*spec.sensors, *spec.skins, *spec.lights, *spec.cameras]:
        spec.delete(part)
    wraps = np.isin(model.wrap_type, (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER))
    named = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist(), *model.wrap_objid[wraps].tolist()}
    for geom in [each for each in spec.geoms if not (each.contype or each.conaffinity or each.id in named)]:
        spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    unused = [*spec.textures, *(mesh for mesh in spec.meshes if mesh.name not in used)]
    for part in unused:
        spec.delete(part)
    _compiled(spec, spec.modelname)


def _inside(file: Path, folder: Path) -> Path:
    """Return `file`; raise ConfigError if it is not in `folder` or below it, links followed."""
    if not file.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"it names {str(file)!r}, which is not below its own folder; copy it there")
    return file


def _check_includes(path: Path, folder: Path, depth: int = 0) -> None:
    """Raise ConfigError if the file at `path` reads one outside `folder`, or too many inside each other."""
    if depth > _MAX_DEPTH:
        raise ConfigError(f"it includes itself, or more than {_MAX_DEPTH} files inside each other")
    for tag, _, name in _NAMING.findall(path.read_text(encoding="utf-8", errors="replace")):
        # MuJoCo looks in the robot's folder, and then in that of the file which names it.
        found = [base / unescape(name) for base in (folder, path.parent)]
        for file in {_inside(each, folder) for each in found if each.exists()}:
            if tag != "flexcomp":
                _check_includes(file, folder, depth + 1)


class Robot(FreeBody):
    """A robot with a free joint, from its file. A policy's controls lie in [-1, 1]; see `control_map`."""

    Options = RobotOptions
    options: RobotOptions  # type: ignore[assignment] - narrower than in Body
    control_unit = "1"
    control_limit = 1.0
    velocity_clip = _MAX_CLIP

    def __init__(self, options: Settings | None = None, file: RobotFile | None = None) -> None:
        """Read the robot of `options`, from `file` if it is given; raise ConfigError if it cannot be driven."""
        super().__init__(options)
        self.file = file or read_robot(self.options.robot)
        self.name = self.file.name
        spec = self._spec()
        model = self.alone()
        if model.nq != model.nv + 1:
            raise ConfigError(f"robot {self.name!r} has ball joints, which a policy here cannot observe. Use hinges.")
        if not 0 < model.njnt - 1 <= _MAX_JOINTS:
            raise ConfigError(
                f"robot {self.name!r} has {model.njnt - 1} joints besides its root, not 1 to {_MAX_JOINTS}."
            )
        if model.nu == 0:
            raise ConfigError(
                f"robot {self.name!r} has no actuators. Add some to its file, or set --motors N (torque)."
            )
        root = self._name(model.body(1).name) or "root"
        kinds = ["rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m" for kind in model.jnt_type[1:]]
        joints = [self._name(model.joint(i).name) or f"joint_{i}" for i in range(1, model.njnt)]
        self.pose, self.velocity, self.egocentric = free_elements(root, joints, kinds)
        self.controls = tuple(self._name(model.actuator(i).name) or f"control_{i}" for i in range(model.nu))
        self.timestep_s = float(model.opt.timestep)
        if not self.options.control_step / _MAX_STEPS <= self.timestep_s <= self.options.control_step:
            raise ConfigError(
                f"control_step is {self.options.control_step:g} s, but the physics step of robot {self.name!r} is "
                f"{self.timestep_s:g} s. Set --control-step to 1 to {_MAX_STEPS} times it, or correct the file."
            )
        self.frame_skip = round(self.options.control_step / self.timestep_s)
        self.home, extent = self._home_pose(spec, model)
        self.mass_kg = float(model.body_subtreemass[0])
        if not (_MIN_M < extent < _MAX_M and 0 < self.mass_kg < _MAX_KG and np.isfinite(self.home).all()):
            raise ConfigError(
                f"robot {self.name!r} is {extent:.3g} m large and weighs {self.mass_kg:.3g} kg, not "
                f"{_MIN_M:g} to {_MAX_M:g} m and up to {_MAX_KG:g} kg. Check its units: metres and kilograms."
            )
        self._home_angles = [(9 + i, angle) for i, angle in enumerate(self.home[7:].tolist()) if angle]
        self.scale = float(f"{extent / ANT_EXTENT_M:.2g}")
        self.block_factor = self.mass_kg / ANT_MASS_KG
        self.control_map, self.home_activation = self._driven(model)

    @classmethod
    def maker(cls, options: Settings) -> Callable[[], Body]:
        """Return a function that makes the robot anywhere, also where its file is not."""
        return partial(cls, options, read_robot(options.robot))  # type: ignore[attr-defined] - of class RobotOptions

    def as_drawn(self) -> Body:
        """Return the robot as it looks, with the shapes that its physics does not need."""
        drawn = copy(self)
        drawn.file = self.file._replace(physics=self.file.content)
        return drawn

    def _spec(self) -> mujoco.MjSpec:
        """Return the robot's spec with the motors of the options."""
        spec = _spec_of(self.file.physics)
        root = _root(spec, self.name)
        if self.options.motors is not None:
            if len(spec.actuators):
                raise ConfigError(f"robot {self.name!r} has actuators of its own. Omit --motors.")
            torque = self.options.motors
            for number, joint in enumerate(root.find_all("joint")):
                if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                    joint.name = joint.name or f"joint_{number}"
                    motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                    motor.set_to_motor()
                    motor.ctrllimited, motor.ctrlrange = True, [-torque, torque]
        return spec

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the robot with its actuators to `spec`, and the physics of its file."""
        child = self._spec()
        for part in [*child.keys, *child.sensors, *child.lights, *child.cameras]:
            child.delete(part)
        for name in _PHYSICS:
            setattr(spec.option, name, getattr(child.option, name))
        spec.assets = child.assets
        child.nkey = spec.nkey  # MuJoCo warns where the two specs differ
        child.visual.map.znear, child.visual.map.zfar = spec.visual.map.znear, spec.visual.map.zfar
        for name in dir(spec):
            if name.startswith("nuser_") or name in ("njmax", "nconmax", "nstack", "memory"):
                setattr(child, name, getattr(spec, name))
        spec.worldbody.add_frame(pos=[0, 0, ground_m]).attach_body(_root(child, self.name), _PREFIX, "")

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether the root tilts by more than 60 degrees, or is lower than half its height at home [N]."""
        assert self.home is not None, "the constructor sets it"
        is_low = qpos[..., 2] - ground_m < _MIN_HEIGHT * self.home[2]
        return is_low | (self.cos_tilt(qpos) < _MIN_COS_TILT)

    def describe(self) -> dict[str, str]:
        """Return what was understood of the file, in words."""
        assert self.home is not None, "the constructor sets it"
        assert self.control_map is not None, "the constructor sets it"
        found = self.found_symmetry()
        turns = "none" if found.turn is None else f"{found.num_turns} turns (difference {found.turn.residual:.1e})"
        mirror = "no mirror" if found.mirror is None else f"mirror (difference {found.mirror.residual:.1e})"
        step = self.frame_skip * self.timestep_s
        return {
            "root": f"{self.pose[0].name.removesuffix('_x')}, {len(self.pose) - 7} joints, {self.mass_kg:.3g} kg",
            "home pose": f"{self.home[2]:.3g} m high; joints " + " ".join(f"{angle:.3g}" for angle in self.home[7:]),
            "actuators": ", ".join(
                f"{name} {offset:.3g} ± {factor:.3g}"
                for name, offset, factor in zip(self.controls, *self.control_map, strict=True)
            ),
            "time": f"physics step {self.timestep_s:g} s, control step {step:g} s",
            "fallen": f"tilt above {MAX_TILT:g} degrees, or lower than {_MIN_HEIGHT * self.home[2]:.3g} m",
            "symmetry": f"{turns}, {mirror}",
            "size": f"{self.scale:g} of the ant's: cells of {8 * self.scale:g} m",
        }

    def _home_pose(self, spec: mujoco.MjSpec, model: mujoco.MjModel) -> tuple[F64Array, float]:
        """Return the home pose [num_qpos] at the origin, lifted onto the ground, and the robot's extent in metres."""
        whole, data = _compiled(spec, self.name), mujoco.MjData(model)
        pose = whole.qpos0
        names = [self._name(whole.key(i).name) for i in range(whole.nkey)]
        wanted = self.options.robot_keyframe
        if wanted is not None and wanted not in names:
            known = f"its keyframes: {', '.join(names)}" if names else "it has none"
            raise ConfigError(f"robot {self.name!r} has no keyframe {wanted!r} ({known}). Change --robot-keyframe.")
        if names:
            pose = whole.key_qpos[0 if wanted is None else names.index(wanted)]
        first = whole.jnt_qposadr[whole.body(_root(spec, self.name).name).jntadr[0]]
        home = pose[first : first + model.nq].copy()
        home[:2] = 0
        data.qpos[:] = home
        mujoco.mj_kinematics(model, data)
        low, high = _bounds(model, data)
        home[2] -= low[2]
        if self.cos_tilt(home) < _MIN_COS_TILT:
            raise ConfigError(
                f"robot {self.name!r} lies in its home pose: its root tilts by more than {MAX_TILT:g} degrees. "
                "Choose another pose with --robot-keyframe."
            )
        return home, float((high - low).max())

    def _driven(self, model: mujoco.MjModel) -> tuple[tuple[F64Array, F64Array], F64Array | None]:
        """Return offset and factor [A] of the actuators' controls, and the activations of the home pose, if any.

        A control of 0 holds the home pose, ±1 is far from it.
        """
        data = mujoco.MjData(model)
        data.qpos[:] = self.home
        mujoco.mj_forward(model, data)
        pairs = [self._range(model, i, float(data.actuator_length[i])) for i in range(model.nu)]
        offset, factor = np.array(pairs).T
        activation = np.zeros(model.na)
        for i in np.flatnonzero(model.actuator_actnum == 1):
            gain, (_, stiffness, _) = model.actuator_gainprm[i, 0], model.actuator_biasprm[i, :3]
            kind, place = mujoco.mjtDyn(model.actuator_dyntype[i]), model.actuator_actadr[i]
            if kind in _FILTERS:  # it follows the control
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

    @staticmethod
    def _name(name: str) -> str:
        return name.removeprefix(_PREFIX)


def _compiled(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    try:
        with warnings.catch_warnings(action="ignore"):
            return spec.compile()
    except ValueError as error:
        raise ConfigError(f"robot {name!r} does not compile: {' '.join(str(error).split())}. {_FIX}") from error


def _root(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    """Return the body with a free joint that has the most joints below it."""
    free = [
        body for body in spec.worldbody.bodies if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)
    ]
    if not free:
        raise ConfigError(f"robot {name!r} has no body with a free joint. Add <freejoint/> to its root body.")
    return max(free, key=lambda body: len(body.find_all("joint")))


def _bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64Array, F64Array]:
    """Return the corners [3] of a box around what collides, in the pose of `data`."""
    collides = ((model.geom_contype | model.geom_conaffinity) & 1).astype(bool) & (model.geom_bodyid > 0)
    turn = data.geom_xmat[collides].reshape(-1, 3, 3)
    centre, half = model.geom_aabb[collides, :3], model.geom_aabb[collides, 3:]
    middle = data.geom_xpos[collides] + (turn @ centre[:, :, None])[:, :, 0]
    reach = (np.abs(turn) @ half[:, :, None])[:, :, 0]
    if not len(middle):
        raise ConfigError("nothing of the robot collides with the floor (contype 1). Give its feet such geoms.")
    return (middle - reach).min(axis=0), (middle + reach).max(axis=0)
