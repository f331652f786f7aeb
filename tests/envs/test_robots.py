"""Robots from MJCF files: what is read, and what is refused. `test_symmetry` tests the symmetry that is found."""

import io
import sys
import zipfile
from types import SimpleNamespace
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shes.envs.bodies.robot import Robot, RobotOptions
from shes.envs.bodies.robot_file import read_robot
from shes.envs.named_environments import ROBOT_ENVIRONMENTS
from shes.errors import ConfigError
from tests.envs.robot_files import TETRAHEDRON, mjcf, one_joint, robot_of, walker
from tests.messages import raises


def flagrun(folder, text, **options):
    """Return two episodes of Flagrun with the robot of `text`, after a reset."""
    own = ROBOT_ENVIRONMENTS["flagrun"].task
    task = own(robot_of(folder, text), 2, own.Options(**options))
    task.reset(np.arange(2), [1, 2])
    return task


TENDON = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/></fixed></tendon>'
KEYS = '<keyframe><key name="low" qpos="3 2 9 1 0 0 0 .3 -.1"/><key name="up" qpos="0 0 0 .8 0 0 .6 0 .2"/></keyframe>'
ACTUATORS = {
    "motor": ('<motor joint="a" ctrlrange="-3 5"/>', "", 1, 4, None),
    "motor by its force": ('<motor joint="a" forcerange="-3 3" gear="7"/>', "", 0, 3, None),
    "general by its force": ('<general joint="a" gainprm="2" forcerange="-3 3"/>', "", 0, 1.5, None),
    "servo": ('<position joint="a" kp="9"/>', "", 0.3, 0.5, None),
    "servo of a joint with limits": ('<position joint="a" kp="9"/>', 'range="-57.29578 45.836624"', 0.3, 0.25, None),
    "servo with gear": ('<position joint="a" kp="9" gear="-2" ctrlrange="-2 2"/>', "", -0.6, 0.7, None),
    "servo with gear and limits": (
        '<position joint="a" kp="9" gear="-2"/>', 'range="-57.29578 45.836624"', -0.6, 0.5, None,
    ),
    "servo at its limit": ('<position joint="a" kp="9" ctrlrange="-1 .2"/>', "", 0.2, 0.12, None),
    "servo of a tendon": ('<position tendon="t" kp="9" ctrlrange="-1 1"/>', "", 0.5, 0.25, None),
    "motor of a tendon": ('<motor tendon="t" ctrlrange="-1 1"/>', "", 0, 1, None),
    "velocity servo": ('<velocity joint="a" kv="2" ctrlrange="-4 4"/>', "", 0, 4, None),
    "rate of a servo": ('<intvelocity joint="a" kp="9" ctrlrange="-4 4" actrange="-2 2"/>', "", 0, 4, 0.3),
    "filtered servo": ('<position joint="a" kp="9" timeconst=".1"/>', "", 0.3, 0.5, 0.3),
    "filter": ('<general joint="a" dyntype="filter" dynprm=".1" ctrlrange="-3 5"/>', "", 1, 4, 1),
    "delayed motor": ('<motor joint="a" ctrlrange="-9 9" delay=".03" nsample="12"/>', "", 0, 9, None),
}  # fmt: skip


@pytest.mark.parametrize(("actuator", "joint", "offset", "factor", "activation"), ACTUATORS.values(), ids=ACTUATORS)
def test_an_output_of_0_holds_the_home_pose_and_1_is_far(tmp_path, actuator, joint, offset, factor, activation):
    task, ids = flagrun(tmp_path, one_joint(actuator, joint=joint, after=KEYS + TENDON)), np.arange(2)
    assert_allclose(np.concatenate(task.body.control_map), [offset, factor], atol=1e-6)
    before = [part.copy() for part in task.sim.state_parts[4:5]]
    task.step(ids, np.array([[0.5], [-1.0]], np.float32))
    assert_allclose(task.sim.ctrl[:, 0], [offset + factor / 2, offset - factor], atol=1e-6)
    if activation is not None:
        assert_allclose(before, [[[activation]] * 2], atol=1e-6)
        assert task.sim.state_parts[4][0] > activation > task.sim.state_parts[4][1]
    # Activations and delayed controls belong to the state.
    task.reset(ids[1:], [1], task.states(ids[:1]))
    for _ in range(3):
        assert_array_equal(*task.states(ids))
        task.step(ids, np.full((2, 1), 0.3, np.float32))


@pytest.mark.parametrize(
    ("keyframe", "after", "joints", "quaternion"),
    [(None, "", [0, 0], 1), (None, KEYS, [0.3, -0.1], 1), ("low", KEYS, [0.3, -0.1], 1), ("up", KEYS, [0, 0.2], 0.8)],
)
def test_the_home_pose_is_a_keyframe_standing_on_the_ground(tmp_path, keyframe, after, joints, quaternion):
    ball = '<body name="ball" pos="3 0 0"><freejoint/><geom size=".1"/></body><geom type="plane" size="1 1 1"/>'
    text = one_joint('<motor joint="a" ctrlrange="-1 1"/>', after=after.replace('qpos="', 'qpos="3 0 0 1 0 0 0 '))
    text = text.replace("<worldbody>", f"<worldbody>{ball}").replace('name="trunk" ', "")
    robot = robot_of(tmp_path, text, robot_keyframe=keyframe)
    model, seen = robot.alone(), np.zeros((1, 13))
    assert (model.nq, model.nbody) == (9, 4)  # without the ball and the plane of its scene
    assert_allclose([*robot.home[:2], robot.home[3], *robot.home[7:]], [0, 0, quaternion, *joints], atol=1e-6)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    mujoco.mj_kinematics(model, data)
    feet = data.geom_xpos[:, 2] - model.geom_size[:, 0]
    assert 0 <= feet.min() + 1e-6 < 0.01  # boxes around geoms are turned with them
    robot.write_egocentric(robot.home[None], np.zeros((1, 8)), np.zeros(1), seen)
    assert_allclose(seen[0], [robot.home[2], *[0] * 12], atol=1e-12)
    low, tilted = robot.home.copy(), robot.home.copy()
    low[2] *= 0.4
    tilted[3:7] = [0.85, 0.53, 0, 0]  # by 64 degrees
    assert [bool(robot.fallen(pose)) for pose in (robot.home, low, tilted)] == [False, True, True]


def test_motors_are_added_to_joints_with_and_without_names(tmp_path):
    robot = robot_of(tmp_path, one_joint("").replace('name="a"', ""), motors=3.0)
    assert robot.controls == ("joint_1", "b")
    assert_array_equal(robot.control_map, [[0, 0], [3, 3]])


def test_workers_receive_the_physics_alone_and_it_is_the_same(tmp_path):
    """Also from the copy in a run folder. What is only looked at or measured is not part of it."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.obj").write_text(TETRAHEDRON)
    (tmp_path / "parts" / "b.obj").write_text(TETRAHEDRON.replace(".1", ".2"))
    assets = (
        '<compiler meshdir="parts"/><asset><mesh file="a.obj"/><mesh file="b.obj"/>'
        '<texture name="sky" builtin="flat" type="2d" width="9" height="9"/>'
        '<material name="skin" texture="sky"/></asset>'
    )
    looks = '<geom type="mesh" mesh="b" contype="0" conaffinity="0" material="skin"/><camera name="eye"/><light/>'
    round_post = (
        '<geom name="w" type="cylinder" size=".05 .1" contype="0" conaffinity="0"/>'
        '<site name="s" pos="0 0 .3"/><site name="t" pos=".3 0 .3"/>'
    )
    wound = '<site site="s"/><geom geom="w"/><site site="t"/>'
    after = f'<tendon><spatial name="cord" stiffness="9">{wound}</spatial></tendon><sensor><gyro site="s"/></sensor>'
    trunk = f'<geom type="mesh" mesh="a"/>{looks}{round_post}'
    robot = robot_of(tmp_path, walker(6, before=assets, after=after, trunk=trunk))
    (tmp_path / "copy.zip").write_bytes(robot.file.content)
    assert read_robot(str(tmp_path / "copy.zip"))[1:] == robot.file[1:]
    whole, drawn, own = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml")), mujoco.MjSpec(), robot.alone()
    robot.as_drawn().add_to(drawn)
    assert (own.nmesh, own.ncam, own.nsensor, own.ngeom) == (1, 0, 0, whole.ngeom - 1)
    assert (drawn.compile().nmesh, own.opt.cone, own.opt.timestep) == (2, mujoco.mjtCone.mjCONE_ELLIPTIC, 0.005)
    names = [zipfile.ZipFile(io.BytesIO(each)).namelist() for each in robot.file[1:]]
    assert names == [["parts/a.obj", "parts/b.obj", "robot.xml"], ["parts/a.obj", "robot.xml"]]
    rng, found = np.random.default_rng(0), []
    qvel, ctrl = rng.normal(size=whole.nv), rng.uniform(-1, 1, whole.nu)
    for model in (whole, own):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = robot.home, qvel, ctrl
        data.qpos[2] += 1
        mujoco.mj_step(model, data, 20)
        found.append(np.concatenate([data.qpos, data.qvel]))
    assert_allclose(*found, atol=1e-3)


def test_worlds_have_the_size_and_mass_of_the_robot(tmp_path):
    (tmp_path / "robot.xml").write_text(walker(6))
    own = {"robot": str(tmp_path / "robot.xml"), "control_step": 0.013}
    task = ROBOT_ENVIRONMENTS["push"].with_options(own).make(20)
    assert task.step_s == pytest.approx(0.015)  # three physics steps
    model, scale = task.sim.model, task.scale
    assert scale == pytest.approx(0.42)
    assert_allclose(model.geom("block").size, np.array([4, 4, 2]) * scale)
    assert_allclose(model.body("block").mass, 0.0002 * model.body_subtreemass[1] / 0.911)
    task.reset(np.arange(20), range(20))
    assert 0.07 * scale < np.abs(task.sim.qpos[:, :2]).max() < 0.1 * scale  # the noise of a reset
    assert (task.sim.qpos[:, 2] >= task.body.home[2]).all()
    assert_allclose(task.observe()[:, -2:], [[0, 19 * scale]] * 20)
    assert_allclose(task.position * scale, task.observe()[:, task.position_columns])
    assert_allclose(task.distance, np.hypot(*(np.array([[0.0, 19.0]]) - task.position).T))


def test_motors_name_joints_as_no_other_is_named(tmp_path):
    text = one_joint("").replace('name="a"', 'name="joint_2"').replace('name="b" ', "")
    assert len(set(robot_of(tmp_path, text, motors=3.0).controls)) == 2


MOTOR_A, MESH = '<motor joint="a" ctrlrange="-1 1"/>', '<asset><mesh name="m" file="{}"/></asset>'
PLAIN = one_joint(MOTOR_A)
MANY = "".join(f'<body><joint name="j{i}"/><geom size=".01"/></body>' for i in range(201))
LYING = '<keyframe><key qpos="0 0 1 .7 .7 0 0 0 0"/></keyframe>'
OUTSIDE = "is not below its own folder"
REFUSED = {
    "empty": ("", {}, "empty file"),
    "no XML": ("legs: 4", {}, "XML parse error"),
    "another root": ("<robot/>", {}, "no body with a free joint"),
    "no free joint": (one_joint("", root=""), {}, "no body with a free joint. Add <freejoint/>"),
    "no actuators": (one_joint(""), {}, "has no actuators ... --motors N"),
    "ball joints": (PLAIN.replace('axis="0 1 0" />', 'type="ball"/>', 2), {}, "ball joints"),
    "no joints": (mjcf(), {"motors": 1.0}, "0 joints"),
    "two hundred joints": (mjcf(legs=MANY, actuators=MOTOR_A.replace("a", "j1", 1)), {}, "201 joints"),
    "nothing collides": (PLAIN.replace("<geom", '<geom contype="2" conaffinity="2"'), {}, "nothing of ... collides"),
    "lying": (one_joint(MOTOR_A, after=LYING), {}, "lies in its home pose ... --robot-key"),
    "no mass": (PLAIN.replace("<geom", '<geom mass="0"'), {}, "mass and inertia of moving bodies must be larger"),
    "millimetres": (PLAIN.replace('size=".1"', 'size="250"'), {}, "m large and weighs ... Check its units"),
    "no limits": (one_joint('<motor joint="a"/>'), {}, "'control_0' of robot 'robot', a motor, has no ctrlrange"),
    "a velocity without limits": (one_joint('<velocity joint="a"/>'), {}, "a velocity servo, has no ctrlrange"),
    "no such keyframe": (PLAIN, {"robot_keyframe": "up"}, "no keyframe 'up' (it has none"),
    "another keyframe": (one_joint("", after=KEYS), {"robot_keyframe": "x", "motors": 1.0}, "keyframes: low, up"),
    "motors twice": (PLAIN, {"motors": 2.0}, "has actuators of its own. Omit --motors"),
    "a short control step": (PLAIN, {"control_step": 0.004}, "step of 0.005 s, but control_step is 0.004 s"),
    "no time step": (
        PLAIN.replace('timestep="0.005"', 'timestep="0"'),
        {},
        "a physics step of 0 s, but control_step is",
    ),
    "a million steps": (PLAIN.replace("0.005", "1e-9", 1), {}, "1e-09 s, ... Set --control-step to 1 to 1000 times it"),
    "no UTF-8": (
        PLAIN.replace('name="a"', 'name="\udcfc"').replace('joint="a"', 'joint="\udcfc"'),
        {},
        "'utf-8' codec",
    ),
    "nobody's home": ("", {"robot": "~nobody-here/robot.xml"}, "'~nobody-here/robot.xml' is no file"),
    "include above": (mjcf(before='<include file="../part.xml"/>'), {}, OUTSIDE),
    "include elsewhere": (mjcf(before='<include class=">" file="&#47;etc/hostname"/>'), {}, OUTSIDE),
    "include by a link": (mjcf(before='<include file="link.xml"/>'), {}, OUTSIDE),
    "include of itself": (mjcf(before='<include file="robot.xml"/>'), {}, "includes itself"),
    "no such include": (mjcf(before='<include file="none.xml"/>'), {}, "none.xml"),
    "model": (mjcf(before='<asset><model name="m" file="../part.xml"/></asset>'), {}, OUTSIDE),
    "flexcomp": (mjcf(trunk='<flexcomp name="f" type="mesh" file="../part.obj"/>'), {}, OUTSIDE),
    "mesh above": (mjcf(before=MESH.format("../part.obj")), {}, OUTSIDE),
    "mesh folder": (mjcf(before='<compiler meshdir=".."/>' + MESH.format("part.obj")), {}, OUTSIDE),
    "mesh by a link": (mjcf(before=MESH.format("link.obj")), {}, OUTSIDE),
    "no such mesh": (mjcf(before=MESH.format("none.obj")), {}, "No such file"),
    "texture": (mjcf(before='<asset><texture type="cube" fileright="../part.xml"/></asset>'), {}, OUTSIDE),
    "large meshes": (mjcf(before=MESH.format("large.obj")), {}, "it has more than 0 MB of files"),
    "large XML": (PLAIN + " " * 60_000, {}, "has 0 MB, more than 0"),
    "a name twice": (PLAIN.replace('name="b"', 'name="trunk_x"'), {}, "two observed values ... are named 'trunk_x'"),
    "no zip file": ({}, {}, "robot.zip' cannot be read: ... not a zip file"),
    "a zip file without XML": ({"a.txt": ""}, {}, "No XML ... Give an archive of a run folder"),
    "an include in a zip file": ({"r.xml": mjcf(before='<include file="/part.xml"/>')}, {}, "includes other files"),
    "a mesh out of a zip file": ({"r.xml": mjcf(before=MESH.format("/part.obj"))}, {}, "lacks the file"),
    "a large zip file": ({"r.xml": PLAIN, "a.txt": "x" * 3_000_000}, {}, "it has more than 0 MB of files"),
}


@pytest.mark.parametrize(("text", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_a_robot_that_cannot_be_driven_is_one_clear_line(tmp_path, monkeypatch, text, options, message):
    """In a folder beside files that are none of its business. A text is that of a file, a dictionary a zip file."""
    folder, path = tmp_path / "folder", "robot.xml" if isinstance(text, str) else "robot.zip"
    folder.mkdir()
    for kind, content in (("xml", "<mujoco/>"), ("obj", TETRAHEDRON)):
        (tmp_path / f"part.{kind}").write_text(content)
        (folder / f"link.{kind}").symlink_to(tmp_path / f"part.{kind}")
    (folder / "large.obj").write_text(TETRAHEDRON + "#" * 60_000)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("shes.envs.bodies.robot_file._MAX_BYTES", 50_000)
    if isinstance(text, str):
        (folder / path).write_text(text, errors="surrogateescape")
    elif not text:
        (folder / path).write_bytes(b"PK\x03\x04")
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in text.items():
                archive.writestr(name, content)
    before = sorted(folder.iterdir())
    with raises(ConfigError, message) as error:
        ROBOT_ENVIRONMENTS["flagrun"].with_options({"robot": path, **options}).make(1)
    assert "\n" not in str(error.value)
    assert sorted(folder.iterdir()) == before


def test_a_robot_of_the_menagerie_is_found_by_its_name(tmp_path, monkeypatch):
    """With a stand-in for the package, whose robots are downloaded at first use."""
    unknown = type("UnknownRobotError", (RuntimeError,), {})

    def get(name):
        if name == "hexapod":
            return SimpleNamespace(xml=lambda: tmp_path / "scene.xml")
        if name == "far":
            return SimpleNamespace(xml=Mock(side_effect=OSError("Network is unreachable")))
        raise unknown(f"Unknown robot {name!r}. Did you mean 'hexapod'?")

    stand_in = SimpleNamespace(get=get, MenagerieError=RuntimeError, UnknownRobotError=unknown)
    (tmp_path / "scene.xml").write_text('<mujoco><include file="hexapod.xml"/></mujoco>')
    (tmp_path / "hexapod.xml").write_text(walker(6))
    for package, name, message in (
        (None, "menagerie:hexapod", "needs the package mujoco-menagerie: pip install 'shes[robots]'"),
        (stand_in, "menagerie:hexapot", "MuJoCo Menagerie has no robot 'hexapot' (Unknown"),
        (stand_in, "menagerie:far", "cannot be downloaded: Network is unreachable. Check the network"),
        (stand_in, "", "which robot?"),
        (stand_in, str(tmp_path), "is no file"),
    ):
        monkeypatch.setitem(sys.modules, "mujoco_menagerie", package)
        with raises(ConfigError, message):
            read_robot(name)
    found = Robot(RobotOptions(robot="menagerie:hexapod"))
    assert (found.name, len(found.controls)) == ("menagerie-hexapod", 12)
