"""Reads the MJCF file of a robot, or an archive of it, with the files that it names. They are input from strangers.

Source: own design; `docs/robots.md`.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from html import unescape
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import mujoco
import numpy as np

from shes.errors import ConfigError
from shes.sim.simulator import log_physics_warnings

MENAGERIE = "menagerie:"
"""Prefix of the name of a robot in the package mujoco-menagerie."""
_MAX_BYTES, _MAX_DEPTH = 200_000_000, 20
_NAMING = re.compile(r"<(include|model|flexcomp)\b.*?\bfile\s*=\s*([\"'])(.*?)\2", re.DOTALL)
"""The elements with which XML reads a file before it is checked."""


class RobotFile(NamedTuple):
    """A robot's file with all that it names, as zip archives, which can be sent and kept in a run folder."""

    name: str
    content: bytes
    """Everything, to draw the robot."""
    physics: bytes
    """The same without visual shapes and sensors, which the physics does not need."""

    @property
    def label(self) -> str:
        """Name, and the first digits of the SHA-256 of its content: two files of one name may be two robots."""
        return f"{self.name} ({sha256(self.content).hexdigest()[:8]})"

    def spec(self) -> mujoco.MjSpec:
        """Return a new spec of the robot for its physics."""
        return mujoco.MjSpec.from_zip(io.BytesIO(self.physics))


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


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Return the model of `spec`, without the warnings of its compiler."""
    with warnings.catch_warnings(action="ignore"):
        return spec.compile()


def _from_menagerie(robot: str) -> Path:
    try:
        import mujoco_menagerie  # type: ignore[import-not-found] - an extra
    except ImportError as error:
        raise ConfigError(f"robot {robot!r} needs the package mujoco-menagerie: pip install 'shes[robots]'.") from error
    name = robot.removeprefix(MENAGERIE)
    try:
        return mujoco_menagerie.get(name).xml()
    except mujoco_menagerie.UnknownRobotError as error:
        raise ConfigError(
            f"MuJoCo Menagerie has no robot {name!r} ({error}). Its names: mujoco_menagerie.names()."
        ) from error
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise ConfigError(
            f"robot {robot!r} cannot be downloaded: {error}. Check the network, or give a file."
        ) from error


@lru_cache(maxsize=4)
def _read(path: Path, name: str, _changed: int) -> RobotFile:
    """Read the robot `name` from the file at `path`, anew if that has changed."""
    is_archive = path.suffix == ".zip"
    try:
        content = path.read_bytes() if is_archive else _zipped(_parsed(path))
        # MuJoCo rounds when it writes XML, so the physics is always that of the copy.
        return RobotFile(name, content, _zipped(_reduced_to_physics(_unzipped(content))))
    except (ValueError, OSError, RuntimeError, zipfile.BadZipFile, mujoco.FatalError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        fix = "Give an archive of a run folder" if is_archive else "Check it with `python -m mujoco.viewer --mjcf FILE`"
        raise ConfigError(f"robot {str(path)!r} cannot be read: {words}. {fix}.") from error


def _parsed(path: Path) -> mujoco.MjSpec:
    """Return the spec of the file at `path` with the files that it names, which lie below its folder."""
    log_physics_warnings()
    _check_includes(path, path.parent)
    with warnings.catch_warnings(action="ignore"):
        spec = mujoco.MjSpec.from_file(str(path))
    files = {name: _inside(path.parent / name, path.parent) for name in _files(spec)}
    _check_size(file.stat().st_size for file in files.values())
    spec.assets = {name: file.read_bytes() for name, file in files.items()}
    return spec


def _unzipped(content: bytes) -> mujoco.MjSpec:
    """Return the spec in an archive, which holds every file that it names."""
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        _check_size(each.file_size for each in packed.infolist())
        texts = [packed.read(name).decode(errors="replace") for name in packed.namelist() if name.endswith(".xml")]
    if any(map(_NAMING.search, texts)):
        raise ConfigError("its XML includes other files")
    spec = mujoco.MjSpec.from_zip(io.BytesIO(content))
    if missing := [name for name in _files(spec) if name not in spec.assets]:
        raise ConfigError(f"it lacks the file {missing[0]!r}")
    return spec


def _check_size(num_bytes: Iterable[int]) -> None:
    if sum(num_bytes) > _MAX_BYTES:
        raise ConfigError(f"it has more than {_MAX_BYTES / 1e6:.0f} MB of files")


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


def _files(spec: mujoco.MjSpec) -> list[str]:
    """Return the paths of the files that `spec` names, relative to its own folder."""
    named = [(spec.meshdir, each.file) for each in (*spec.meshes, *spec.hfields, *spec.skins)]
    named += [(spec.texturedir, file) for each in spec.textures for file in (each.file, *each.cubefiles)]
    return list(dict.fromkeys(str(PurePosixPath(folder) / file) for folder, file in named if file))


def _zipped(spec: mujoco.MjSpec) -> bytes:
    """Return an archive of `spec` with the files that it names alone; `MjSpec.to_zip` writes all it once had."""
    packed = io.BytesIO()
    compiled(spec)  # `to_xml` needs it
    with warnings.catch_warnings(action="ignore"):
        text = spec.to_xml()
    with zipfile.ZipFile(packed, "w") as archive:
        for name in _files(spec):
            archive.writestr(zipfile.ZipInfo(name), spec.assets[name])
        archive.writestr(zipfile.ZipInfo("robot.xml"), text)
    return packed.getvalue()


def _reduced_to_physics(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return `spec` without what the physics does not need."""
    model = compiled(spec)
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
    return spec
