"""Robots from MJCF files: what is read, what is refused, and the symmetry that their physics proves."""

import io
import sys
import zipfile
from types import SimpleNamespace
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shes.agents.goal_agent import Frames
from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import dihedral_group
from shes.envs.bodies.robot import Robot, RobotOptions
from shes.envs.bodies.robot_file import read_robot
from shes.envs.named_environments import ROBOT_ENVIRONMENTS
from shes.errors import ConfigError
from tests.envs.robot_files import TETRAHEDRON, mjcf, one_joint, walker

SERVO = '<position joint="{}" kp="20"/>'


@pytest.fixture
def make(tmp_path):
    """Return a function that makes a robot of MJCF text."""

    def robot(text, name="robot.xml", **options):
        (tmp_path / name).write_text(text)
        return Robot(RobotOptions(robot=str(tmp_path / name), **options))

    return robot


def task(robot, num_episodes=1, name="flagrun", **options):
    """Return a task with `robot`."""
    own = ROBOT_ENVIRONMENTS[name].task
    return own(robot, num_episodes, own.Options(**options))


def signed_permutation(source, sign):
    """Return the matrix [V, V] of `new[i] = sign[i] * old[source[i]]`."""
    return np.eye(len(source))[list(source)] * np.array(sign)[:, None]


# Symmetry.


def test_the_ants_symmetry_is_that_of_its_tables_by_hand():
    """Legs 1 to 4 are at 45, 135, 225 and 315 degrees; the motors are those of legs 4, 1, 2, 3."""
    flexion = [1, -1, -1, 1]

    def legs(order, partner, hip):
        index, sign = [], []
        for leg in order:
            first = 2 * order.index(partner[leg])
            index += [first, first + 1]
            sign += [hip, flexion[leg] * flexion[partner[leg]]]
        return index, sign

    def element(source, sign, spin, partner, hip):
        joints, signs = legs((0, 1, 2, 3), partner, hip)
        index = [0, *source, *(2 + i for i in source), 5, *(5 + i for i in source), 8]
        index += [first + i for first in (9, 17) for i in joints]
        view = signed_permutation(index, [1, *sign, *sign, 1, *spin, hip, *signs, *signs])
        return view, signed_permutation(*legs((3, 0, 1, 2), partner, hip))

    turn = element([2, 1], [1, -1], [1, -1], [1, 2, 3, 0], 1)
    mirror = element([1, 2], [1, -1], [-1, 1], [3, 2, 1, 0], -1)
    for is_mirrored in (False, True):
        wanted = vars(dihedral_group(4, turn, mirror, is_mirrored=is_mirrored))
        found = vars(Ant().symmetry(is_mirrored=is_mirrored))
        assert found.keys() == wanted.keys()
        for name, value in wanted.items():
            assert_array_equal(found[name], value, err_msg=name)


UNEVEN = '<geom size=".1" pos=".1 .1 .1" mass="{}"/>'
SIDES = '<position joint="{0}" kp="20" ctrlrange="{1}"/>'
RANGES = (".1 .6", "-.6 -.1")
"""Ranges of a left and a right swing that mirror each other, without the home pose."""


def sides(left, right):
    """Return position servos for four legs: the swings of the left ones have range `left`, the others `right`."""
    swings = [SIDES.format(f"swing_{leg}", left if leg < 2 else right) for leg in range(4)]
    return "".join(swings) + "".join(SERVO.format(f"lift_{leg}") for leg in range(4))


GROUPS = {
    **{f"{legs} legs": (walker(legs), legs, True) for legs in (3, 4, 5, 6, 8)},
    "servos": (walker(6, actuator=SERVO), 6, True),
    "filtered": (walker(4, actuator='<position joint="{}" kp="20" timeconst=".05"/>'), 4, True),
    "ranges that mirror": (walker(4, actuators=sides(*RANGES)), 1, True),
    "ranges that do not": (walker(4, actuators=sides(RANGES[0], RANGES[0])), 4, False),
    "ranges of two sizes": (walker(4, actuators=sides("-.6 .6", "-.3 .3")), 1, False),
    "limits of two sizes": (walker(4, actuator=SERVO).replace('range="-40 40"', 'range="-20 20"', 1), 1, False),
    "uneven": (walker(6, trunk=UNEVEN.format(4)), 1, False),
    "hardly uneven": (walker(6, trunk=UNEVEN.format(0.001)), 6, True),
    "mass ahead": (walker(6, trunk=UNEVEN.format(4).replace(".1 .1 .1", ".2 0 .1")), 1, True),
}


@pytest.mark.parametrize(("text", "num_turns", "is_mirrored"), GROUPS.values(), ids=GROUPS)
def test_the_symmetry_of_a_robot_is_found(make, text, num_turns, is_mirrored):
    robot = make(text)
    found = robot.found_symmetry()
    assert (found.num_turns, found.mirror is not None) == (num_turns, is_mirrored)
    group = robot.symmetry(is_mirrored=True)
    assert (group is None) == (num_turns == 1 and not is_mirrored)
    if group is not None:
        assert (group.num_turns, group.is_mirrored) == (num_turns, is_mirrored)
        assert group.shifts_clock == (num_turns == 1)


@pytest.mark.parametrize("name", ["6 legs", "5 legs", "servos", "filtered", "ranges that mirror"])
def test_a_robot_moves_in_an_image_as_the_image_of_it(make, name):
    """Its views, given in the frame of each element, are those of a robot that was turned and mirrored in this way."""
    robot = make(GROUPS[name][0])
    group = robot.symmetry(is_mirrored=True)
    count, rng = len(group.view_index), np.random.default_rng(0)
    env = task(robot, 2 * count, reset_noise=0.0)
    env.reset(np.arange(2 * count), range(2 * count))
    frames, goals = Frames(group, count), np.stack(group.direction()[:2], axis=1)
    goals += 0.1 * np.stack([-goals[:, 1], goals[:, 0]], axis=1) * group.direction()[2][:, None]  # left, or right
    frames.choose(slice(None), goals)
    assert_allclose(frames.turned(goals), np.tile([1.0, 0.1], (count, 1)), atol=1e-12)
    qpos, qvel = env.sim.qpos, env.sim.qvel
    state = np.concatenate([[0, 0, 0.02], rng.normal(0, 0.1, robot.num_qpos - 7), rng.normal(0, 0.3, robot.num_qvel)])
    elements = [(k, flip) for flip in (1, -1) for k in range(group.num_turns)][:count]
    for row, (k, flip) in enumerate(elements):
        for each, is_image in ((row, False), (count + row, True)):
            qpos[each, 2] += 0.02
            qpos[each, 7:] += state[3 : robot.num_qpos - 4]
            qvel[each] = state[robot.num_qpos - 4 :]
            if is_image:
                to_image(robot, env, each, k, flip)
    views = np.zeros((2 * count, len(robot.egocentric)))
    seen = np.zeros((count, len(robot.egocentric)))
    for step in range(6):
        robot.write_egocentric(qpos, qvel, robot.frame_angle(qpos), views)
        frames.view(views[count:], seen)
        # MuJoCo writes XML with six digits, so turns that are no quarter turns map the legs to about a micrometre.
        assert_allclose(seen, views[:count], atol=1e-4 if step else 1e-11, err_msg=f"step {step}")
        controls = np.tile(rng.uniform(-1, 1, env.action_size).astype(np.float32), (count, 1))
        env.step(np.arange(2 * count), np.concatenate([controls, frames.controls(controls)]))
    assert not env.diverged.any()
    assert (frames.clock_sign is not None) == group.shifts_clock
    if group.shifts_clock:
        assert frames.clock_sign[:, 0].tolist() == [1, -1]


def to_image(robot, env, row, k, flip):
    """Replace the state of `row` by one whose view in the frame of turn `k`, mirrored if `flip` is -1, is the same.

    The matrices are orthogonal, so the image is the transposed of an element, applied to the state at heading 0.
    """
    group, body = robot.symmetry(is_mirrored=True), slice(9, None)
    element = k + group.num_turns * (flip == -1)
    view = np.zeros((1, len(robot.egocentric)))
    qpos, qvel = env.sim.qpos[row : row + 1], env.sim.qvel[row : row + 1]
    robot.write_egocentric(qpos, qvel, np.zeros(1), view)
    size = view.shape[1]
    matrix = (
        group.view_matrix[element]
        if group.view_matrix is not None
        else signed_permutation(group.view_index[element], group.view_sign[element])
    )
    image = matrix.T @ view[0]
    joints = (size - 9) // 2
    qpos[0, 7:] = image[body][:joints] + robot.home[7:]
    qvel[0] = np.concatenate([image[3:6], image[6:9], image[body][joints:]])


# What is read.

TENDON = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/></fixed></tendon>'
KEYS = '<keyframe><key name="low" qpos="3 2 9 1 0 0 0 .3 -.1"/><key name="up" qpos="0 0 0 .8 0 0 .6 0 .2"/></keyframe>'
AFTER_KEY = {"after": KEYS + TENDON}
ACTUATORS = {
    "motor": ('<motor joint="a" ctrlrange="-3 5"/>', {}, 1, 4),
    "motor by its force": ('<motor joint="a" forcerange="-3 3" gear="7"/>', {}, 0, 3),
    "general by its force": ('<general joint="a" gainprm="2" forcerange="-3 3"/>', {}, 0, 1.5),
    "servo": ('<position joint="a" kp="9"/>', AFTER_KEY, 0.3, 0.5),
    "servo of a joint with limits": (
        '<position joint="a" kp="9"/>', {"joint": 'range="-57.29577951 45.83662361"', **AFTER_KEY}, 0.3, 0.25,
    ),
    "servo with gear": ('<position joint="a" kp="9" gear="-2" ctrlrange="-2 2"/>', AFTER_KEY, -0.6, 0.7),
    "servo at its limit": ('<position joint="a" kp="9" ctrlrange="-1 .2"/>', AFTER_KEY, 0.2, 0.12),
    "servo of a tendon": ('<position tendon="t" kp="9" ctrlrange="-1 1"/>', AFTER_KEY, 0.5, 0.25),
    "motor of a tendon": ('<motor tendon="t" ctrlrange="-1 1"/>', AFTER_KEY, 0, 1),
    "velocity servo": ('<velocity joint="a" kv="2" ctrlrange="-4 4"/>', {}, 0, 4),
    "rate of a servo": ('<intvelocity joint="a" kp="9" ctrlrange="-4 4" actrange="-2 2"/>', AFTER_KEY, 0, 4),
}  # fmt: skip


@pytest.mark.parametrize(("actuator", "parts", "offset", "factor"), ACTUATORS.values(), ids=ACTUATORS)
def test_an_output_of_0_holds_the_home_pose_and_1_is_far(make, actuator, parts, offset, factor):
    robot = make(one_joint(actuator, **parts))
    assert_allclose(np.concatenate(robot.control_map), [offset, factor], atol=1e-6)
    env = task(robot, 2, reset_noise=0.0)
    env.reset(np.arange(2), [0, 0])
    env.step(np.arange(2), np.array([[0.0], [-1.0]], np.float32))
    assert_allclose(env.sim.ctrl[:, 0], [offset, offset - factor], atol=1e-6)


@pytest.mark.parametrize(
    ("actuator", "activation"),
    [
        ('<position joint="a" kp="9" timeconst=".1"/>', 0.3),
        ('<intvelocity joint="a" kp="9" ctrlrange="-4 4" actrange="-2 2"/>', 0.3),
        ('<general joint="a" dyntype="filter" dynprm=".1" ctrlrange="-3 5"/>', 1.0),
    ],
)
def test_activations_hold_the_home_pose_and_belong_to_the_state(make, actuator, activation):
    env = task(make(one_joint(actuator, **AFTER_KEY)), 2)
    ids, act = np.arange(2), env.sim.state_parts[4]
    env.reset(ids, [1, 2])
    assert_allclose(act, [[activation]] * 2, atol=1e-6)
    env.step(ids, np.array([[1.0], [-1.0]], np.float32))
    assert act[0] > activation > act[1]
    env.reset(ids[1:], [1], env.states(ids[:1]))
    assert act[1] == act[0]
    for _ in range(3):
        env.step(ids, np.full((2, 1), 0.3, np.float32))
    assert_array_equal(*env.states(ids))


def test_delayed_controls_belong_to_the_state_as_well(make):
    env = task(make(one_joint('<motor joint="a" ctrlrange="-9 9" delay=".03" nsample="12"/>')), 2)
    ids = np.arange(2)
    env.reset(ids, [1, 2])
    for action in ([[1.0], [-1.0]], [[0.5], [0.2]]):
        env.step(ids, np.array(action, np.float32))
    env.reset(ids[1:], [1], env.states(ids[:1]))
    env.step(ids, np.full((2, 1), 0.3, np.float32))
    assert_array_equal(*env.states(ids))


@pytest.mark.parametrize(
    ("keyframe", "after", "joints", "quaternion"),
    [(None, "", [0, 0], 1), (None, KEYS, [0.3, -0.1], 1), ("low", KEYS, [0.3, -0.1], 1), ("up", KEYS, [0, 0.2], 0.8)],
)
def test_the_home_pose_is_a_keyframe_standing_on_the_ground(make, keyframe, after, joints, quaternion):
    ball = '<body name="ball" pos="3 0 0"><freejoint/><geom size=".1"/></body><geom type="plane" size="1 1 1"/>'
    text = one_joint('<motor joint="a" ctrlrange="-1 1"/>', after=after.replace('qpos="', 'qpos="3 0 0 1 0 0 0 '))
    robot = make(text.replace("<worldbody>", f"<worldbody>{ball}"), robot_keyframe=keyframe)
    model = robot.alone()
    assert (model.nq, model.nbody) == (9, 4)  # without the ball and the plane of its scene
    assert_allclose([*robot.home[:2], robot.home[3], *robot.home[7:]], [0, 0, quaternion, *joints], atol=1e-6)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    mujoco.mj_kinematics(model, data)
    feet = data.geom_xpos[:, 2] - model.geom_size[:, 0]
    assert 0 <= feet.min() + 1e-6 < 0.01  # boxes around geoms are turned with them
    assert not robot.fallen(robot.home)
    assert robot.fallen(np.array([*robot.home[:2], 0.4 * robot.home[2], *robot.home[3:]]))


def test_motors_are_added_to_joints_with_and_without_names(make):
    text = one_joint("").replace('name="a"', "")
    robot = make(text, motors=3.0)
    assert robot.controls == ("joint_1", "b")
    assert_array_equal(robot.control_map, [[0, 0], [3, 3]])


def test_workers_receive_the_physics_alone_and_it_is_the_same(make, tmp_path):
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
    robot = make(walker(6, before=assets, after=after, trunk=f'<geom type="mesh" mesh="a"/>{looks}{round_post}'))
    (tmp_path / "copy.zip").write_bytes(robot.file.content)
    assert read_robot(str(tmp_path / "copy.zip"))[1:] == robot.file[1:]
    whole, drawn, own = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml")), mujoco.MjSpec(), robot.alone()
    robot.as_drawn().add_to(drawn)
    assert (own.nmesh, own.ncam, own.nsensor, own.ngeom) == (1, 0, 0, whole.ngeom - 1)
    assert drawn.compile().nmesh == 2
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


# What is refused.

PLAIN = one_joint('<motor joint="a" ctrlrange="-1 1"/>')
MESH = '<asset><mesh name="m" file="{}"/></asset>'
MANY = "".join(f'<body><joint name="j{i}"/><geom size=".01"/></body>' for i in range(1000))
LYING = '<keyframe><key qpos="0 0 1 .7 .7 0 0 0 0"/></keyframe>'
OUTSIDE = "is not below its own folder"
REFUSED = {
    "empty": ("", {}, "empty file"),
    "no XML": ("legs: 4", {}, "XML parse error"),
    "another root": ("<robot/>", {}, "no body with a free joint"),
    "no free joint": (one_joint("", root=""), {}, "no body with a free joint. Add <freejoint/>"),
    "no actuators": (one_joint(""), {}, "has no actuators.*--motors N"),
    "ball joints": (PLAIN.replace("axis=\"0 1 0\" />", 'type="ball"/>', 2), {}, "ball joints"),
    "no joints": (mjcf(), {"motors": 1.0}, "0 joints"),
    "a thousand joints": (mjcf(legs=MANY, actuators='<motor joint="j1" ctrlrange="-1 1"/>'), {}, "1000 joints"),
    "nothing collides": (PLAIN.replace("<geom", '<geom contype="2" conaffinity="2"'), {}, "nothing of robot .* coll"),
    "lying": (one_joint('<motor joint="a" ctrlrange="-1 1"/>', after=LYING), {}, "lies in its home pose.*--robot-key"),
    "no mass": (PLAIN.replace("<geom", '<geom mass="0"'), {}, "mass and inertia of moving bodies must be larger"),
    "millimetres": (PLAIN.replace('size=".1"', 'size="250"'), {}, "m large and weighs .* Check its units"),
    "no limits": (one_joint('<motor joint="a"/>'), {}, "'control_0' of robot 'robot', a motor, has no ctrlrange"),
    "a velocity without limits": (one_joint('<velocity joint="a"/>'), {}, "a velocity servo, has no ctrlrange"),
    "no such keyframe": (PLAIN, {"robot_keyframe": "up"}, "no keyframe 'up' .it has none"),
    "another keyframe": (one_joint("", after=KEYS), {"robot_keyframe": "x", "motors": 1.0}, "keyframes: low, up"),
    "motors twice": (PLAIN, {"motors": 2.0}, "has actuators of its own. Omit --motors"),
    "a short control step": (PLAIN, {"control_step": 0.004}, "physics step of 0.005 s, not .* control_step, 0.004 s. Set --c"),
    "no time step": (PLAIN.replace('timestep="0.005"', 'timestep="0"'), {}, "a physics step of 0 s, not above 0"),
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
    "side of a texture": (
        mjcf(before='<asset><texture name="t" type="cube" fileright="../part.xml"/></asset>'), {}, OUTSIDE,
    ),
}  # fmt: skip


@pytest.fixture
def strangers(tmp_path):
    """A folder for a robot, beside files that are none of its business."""
    (tmp_path / "part.xml").write_text("<mujoco/>")
    (tmp_path / "part.obj").write_text(TETRAHEDRON)
    folder = tmp_path / "folder"
    folder.mkdir()
    for kind in ("xml", "obj"):
        (folder / f"link.{kind}").symlink_to(tmp_path / f"part.{kind}")
    return folder


@pytest.mark.parametrize(("text", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_cannot_be_driven_is_one_clear_line(strangers, monkeypatch, text, options, message):
    monkeypatch.chdir(strangers)
    (strangers / "robot.xml").write_text(text)
    before = sorted(strangers.iterdir())
    with pytest.raises(ConfigError, match=message) as error:
        Robot(RobotOptions(robot="robot.xml", **options))
    assert "\n" not in str(error.value)
    assert sorted(strangers.iterdir()) == before


def test_an_archive_is_read_as_carefully(strangers, monkeypatch):
    path = strangers / "robot.zip"
    cases = {
        "not a zip file": None,
        "No XML": {"a.txt": ""},
        "includes other files": {"r.xml": mjcf(before=f'<include file="{strangers.parent}/part.xml"/>')},
        "lacks the file": {"r.xml": mjcf(before=MESH.format(strangers.parent / "part.obj"))},
        "more than 0 MB": {"r.xml": PLAIN, "a.txt": "x" * 3_000_000},
    }
    for message, files in cases.items():
        path.write_bytes(b"PK\x03\x04")
        if files is not None:
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
                for name, text in files.items():
                    archive.writestr(name, text)
        if "MB" in message:
            monkeypatch.setattr("shes.envs.bodies.robot_file._MAX_BYTES", 100_000)
        with pytest.raises(ConfigError, match=f"robot.zip' cannot be read: .*{message}"):
            read_robot(str(path))


def test_files_and_meshes_have_a_largest_size(strangers, monkeypatch):
    path = strangers / "robot.xml"
    path.write_text(mjcf(before=MESH.format("a.obj")))
    (strangers / "a.obj").write_text(TETRAHEDRON + "#" * 100_000)
    monkeypatch.setattr("shes.envs.bodies.robot_file._MAX_BYTES", 50_000)
    with pytest.raises(ConfigError, match=r"more than 0 MB of files"):
        read_robot(str(path))
    path.write_text(PLAIN + " " * 100_000)
    with pytest.raises(ConfigError, match=r"has 0 MB, more than 0"):
        read_robot(str(path))
    for name in ("", None, str(strangers), str(strangers / "none.xml")):
        with pytest.raises(ConfigError, match=r"is no file|which robot"):
            read_robot(name)


def test_joints_with_the_names_of_other_values_are_refused(make):
    with pytest.raises(ConfigError, match=r"two observed values of robot-flagrun are named 'trunk_x'"):
        task(make(PLAIN.replace('name="b"', 'name="trunk_x"')))


def test_a_robot_of_the_menagerie_is_found_by_its_name(tmp_path, monkeypatch):
    """With a stand-in for the package, whose robots are downloaded at first use."""

    class MenagerieError(Exception):
        pass

    class UnknownRobotError(MenagerieError, LookupError):
        pass

    def get(name):
        if name == "hexapod":
            return SimpleNamespace(xml=lambda: tmp_path / "scene.xml")
        if name == "far":
            return SimpleNamespace(xml=Mock(side_effect=OSError("Network is unreachable")))
        raise UnknownRobotError(f"Unknown robot {name!r}. Did you mean 'hexapod'?")

    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(ConfigError, match=r"needs the package mujoco-menagerie: pip install 'shes\[robots\]'"):
        read_robot("menagerie:hexapod")
    stand_in = SimpleNamespace(get=get, MenagerieError=MenagerieError, UnknownRobotError=UnknownRobotError)
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", stand_in)
    (tmp_path / "scene.xml").write_text('<mujoco><include file="hexapod.xml"/></mujoco>')
    (tmp_path / "hexapod.xml").write_text(walker(6))
    found = Robot(RobotOptions(robot="menagerie:hexapod"))
    assert (found.name, len(found.controls)) == ("menagerie-hexapod", 12)
    with pytest.raises(ConfigError, match=r"has no robot 'hexapot' .*Did you mean 'hexapod'"):
        read_robot("menagerie:hexapot")
    with pytest.raises(ConfigError, match=r"cannot be downloaded: Network is unreachable. Check the network"):
        read_robot("menagerie:far")
