"""Robots from MJCF files: what is read, what is refused, and the symmetry that their physics proves."""

import itertools
import sys
import zipfile
from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal

from shes.agents.goal_agent import Frames
from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import dihedral_group, signed_permutation
from shes.envs.bodies.robot import Robot, RobotOptions, read_robot
from shes.envs.named_environments import ROBOT_ENVIRONMENTS
from shes.envs.tasks.task import TaskOptions
from shes.errors import ConfigError
from tests.envs.robot_files import ASSETS, MOTOR, TETRAHEDRON, mjcf, one_joint, walker

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
    count, rng = group.num_elements, np.random.default_rng(0)
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
