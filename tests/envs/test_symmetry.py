"""The symmetry of robots: equal motion in MuJoCo, and equal actions, in a rotated or reflected world.

A world is rotated about the vertical, or reflected (y -> -y), by an orthogonal matrix S. A robot's symmetry T maps its
body onto itself and every leg onto another: a robot of pose R in the first world looks like one of pose S R T^-1, with
permuted legs, in the second. `Images` derives this from the model's geometry alone, not from the group that is found.
"""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.agents.agent import AgentInputs
from shes.agents.goal_agent import Frames, GoalDesign
from shes.agents.goals import AngleEncoding
from shes.agents.mlp import MLP
from shes.agents.rewards import ProgressReward
from shes.agents.views import EgocentricView
from shes.envs.bodies.ant import Ant
from shes.envs.worlds import empty_world
from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from tests.envs.robot_files import FILTER, SERVO, robot_of, sides, walker

UNEVEN = '<geom size=".1" pos=".1 .1 .1" mass="{}"/>'
MIRRORED, TWICE = (".1 .6", "-.6 -.1"), '<motor joint="{0}" ctrlrange="-2 2"/><position joint="{0}" kp="20"/>'
GAIN = '<general joint="{}" dyntype="filter" dynprm=".1" gainprm="5" ctrlrange="-2 2"/>'
ROBOTS = {
    **{f"{legs} legs": (walker(legs), legs, True) for legs in (3, 4, 5, 6, 8)},
    "servos": (walker(6, actuator=SERVO), 6, True),
    "filtered": (walker(4, actuator=FILTER), 4, True),
    "two actuators at a joint": (walker(4, actuator=TWICE), 4, True),
    "filters of two gains": (walker(4, actuator=GAIN).replace('gainprm="5"', 'gainprm="15"', 1), 1, False),
    "motors stronger to one side": (walker(4, actuator='<motor joint="{}" ctrlrange="-3 5"/>'), 4, False),
    "ranges that mirror": (walker(4, actuators=sides(*MIRRORED)), 1, True),
    "ranges that do not": (walker(4, actuators=sides(MIRRORED[0], MIRRORED[0])), 4, False),
    "ranges of two sizes": (walker(4, actuators=sides("-.6 .6", "-.3 .3")), 1, False),
    "limits of two sizes": (walker(4, actuator=SERVO).replace('range="-40 40"', 'range="-20 20"', 1), 1, False),
    "uneven": (walker(6, trunk=UNEVEN.format(4)), 1, False),
    "hardly uneven": (walker(6, trunk=UNEVEN.format(0.001)), 6, True),
    "mass ahead": (walker(6, trunk=UNEVEN.format(4).replace(".1 .1 .1", ".2 0 .1")), 1, True),
}
"""Robots, with the number of turns and whether there is a mirror in their symmetry."""
MOVED = ("ant", "6 legs", "5 legs", "servos", "filtered", "ranges that mirror")
MIRRORS = np.eye(3), np.diag([1.0, -1.0, 1.0])


def make(folder, name):
    """Return the body `name`: the ant or one of `ROBOTS`."""
    return Ant() if name == "ant" else robot_of(folder, ROBOTS[name][0])


def turned(angle):
    """Return the rotation [3, 3] about the vertical by `angle`; quarter turns are exact."""
    c, s = (0.0 if abs(each) < 1e-9 else each for each in (np.cos(angle), np.sin(angle)))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def elements(num_turns):
    """Return the symmetries of a body: its turns to the left, and each of them after a mirroring."""
    return [turned(2 * np.pi * k / num_turns) @ mirror for mirror in MIRRORS for k in range(num_turns)]


def on_a_floor(body, integrator="euler"):
    """Return the model of `body` on an infinite floor."""
    spec = empty_world(body.name, integrator, body.timestep_s)
    body.add_to(spec)
    return spec.compile()


class Images:
    """Images of states, controls and goals of `model`, a robot whose joints follow its free joint in qpos and qvel."""

    def __init__(self, model, world, element):
        """Map by `world` [3, 3] and the body's `element` [3, 3]: both rotations or both reflections."""
        assert np.isclose(np.linalg.det(world), np.linalg.det(element))
        self.model, self.world, self.element = model, world, element
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)  # all legs stretched, the torso upright: places and axes are the torso's
        places, axes = data.xanchor[1:] - data.xpos[1], data.xaxis[1:]
        # An axis of rotation is a pseudovector.
        there, around = places @ element.T, np.linalg.det(element) * axes @ element.T
        is_image = np.isclose(places[:, None], there, atol=1e-5).all(axis=2) & np.isclose(np.abs(axes @ around.T), 1)
        assert (is_image.sum(axis=1) == 1).all()
        self.source = is_image.argmax(axis=1)
        self.sign = np.rint((axes @ around.T)[range(len(axes)), self.source])

    def qpos(self, qpos):
        rotation, quaternion = np.zeros(9), np.zeros(4)
        mujoco.mju_quat2Mat(rotation, qpos[3:7])
        mujoco.mju_mat2Quat(quaternion, (self.world @ rotation.reshape(3, 3) @ self.element.T).ravel())
        return np.concatenate([self.world @ qpos[:3], quaternion, self._joints(qpos[7:])])

    def qvel(self, qvel):
        # MuJoCo gives the torso's rotation about its own axes: a pseudovector.
        spin = np.linalg.det(self.element) * self.element @ qvel[3:6]
        return np.concatenate([self.world @ qvel[:3], spin, self._joints(qvel[6:])])

    def ctrl(self, ctrl):
        joints = self.model.jnt_qposadr[self.model.actuator_trnid[:, 0]] - 7
        by_joint = np.zeros(len(joints))
        by_joint[joints] = ctrl
        return self._joints(by_joint)[joints]

    def point(self, place):
        """Return the image of a position or direction on the ground [2]."""
        return self.world[:2, :2] @ place

    def _joints(self, values):
        return self.sign * values[self.source]


@pytest.mark.parametrize(("name", "num_turns", "is_mirrored"), [(name, *own[1:]) for name, own in ROBOTS.items()])
def test_the_symmetry_of_a_robot_is_found(tmp_path, name, num_turns, is_mirrored):
    robot = make(tmp_path, name)
    for asked in (False, True):
        group = robot.symmetry(is_mirrored=asked)
        if num_turns == 1 and not (is_mirrored and asked):
            assert group is None
        else:
            assert (group.num_turns, group.is_mirrored) == (num_turns, is_mirrored and asked)
            assert len(group.view_index) == num_turns * (1 + group.is_mirrored)


def test_the_ants_symmetry_is_that_of_its_tables_by_hand():
    """Legs 1 to 4 are at 45, 135, 225 and 315 degrees, the motors those of legs 4, 1, 2, 3; ankles 2 and 3 differ."""
    turn = [12, -13, 14, 15, 16, -17, 10, 11], [3, 4, 5, -6, 7, 8, 1, -2]
    mirror = [-16, 17, -14, 15, -12, 13, -10, 11], [-3, 4, -1, 2, -7, 8, -5, 6]

    def signed(values):
        return [np.abs(values) - 1, np.sign(values)]

    group = Ant().symmetry(is_mirrored=True)
    for element, head, (joints, controls) in ((1, [1, 3, -2, 5, -4, 6, 8, -7, 9], turn), (4, None, mirror)):
        view = [*(head or [1, 2, -3, 4, -5, 6, -7, 8, -9]), *joints, *np.sign(joints) * (np.abs(joints) + 8)]
        assert_array_equal([group.view_index[element], group.view_sign[element]], signed(view))
        inverse = np.argsort(np.abs(controls))
        own = signed((inverse + 1) * np.sign(controls)[inverse])
        assert_array_equal([group.control_index[element], group.control_sign[element]], own)


@pytest.mark.parametrize("name", MOVED)
def test_every_goal_is_turned_ahead_and_mirrored_to_the_left(tmp_path, name):
    angles = np.deg2rad(np.concatenate([np.arange(-180, 181, 1.5), np.arange(-180, 181, 45.0)]))
    radius = np.random.default_rng(2).uniform(0.01, 9, len(angles))
    goals = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    for is_mirrored in (False, True):
        group = make(tmp_path, name).symmetry(is_mirrored=is_mirrored)
        if group is None:
            continue
        frames, half = Frames(group, len(goals)), 180 / group.num_turns
        frames.choose(slice(None), goals)
        ahead, left = frames.turned(goals).T
        bearing = np.rad2deg(np.arctan2(left, ahead))
        assert np.hypot(ahead, left) == pytest.approx(radius)
        assert np.abs(bearing).max() <= half + 1e-9
        assert bearing.min() >= -1e-9 if group.is_mirrored else bearing.min() < -half / 2
        assert bearing.max() > half / 2
        assert set(group.choose(*goals.T)) == set(range(len(group.view_index)))
        # The clock is half a period later in a mirrored frame if left and right legs take turns.
        signs = None if frames.clock_sign is None else set(frames.clock_sign.ravel().tolist())
        assert signs == ({1, -1} if group.num_turns == 1 else None)


@pytest.mark.parametrize(("name", "integrator"), [*((name, "euler") for name in MOVED), ("ant", "rk4")])
def test_the_motion_in_an_image_of_the_world_is_the_image(tmp_path, name, integrator):
    """In the world rotated like the body's element, and in one rotated by a further quarter turn.

    MuJoCo processes the contacts of an image in another order, so the motions differ by rounding, and by that of the
    numbers in a robot's file. A wrong sign shows in the first step, by a hundredth or more.
    """
    body = make(tmp_path, name)
    model, group = on_a_floor(body, integrator), body.symmetry(is_mirrored=True)
    home, (offset, factor) = model.qpos0 if name == "ant" else body.home, body.control_map or (0, 30)
    tolerance = 1e-9 if name == "ant" else 1e-3
    for number, element in enumerate(elements(group.num_turns)):
        images = Images(model, turned(number * np.pi / 2) @ element, element)
        robot, image, rng, contacts = mujoco.MjData(model), mujoco.MjData(model), np.random.default_rng(number), 0
        half = rng.uniform(-np.pi, np.pi) / 2
        robot.qpos[:] = [0, 0, 0.55 if name == "ant" else home[2], np.cos(half), 0, 0, np.sin(half), *home[7:]]
        robot.qpos[7:] += model.jnt_range[1:].mean(axis=1)
        robot.qvel[:] = rng.normal(0, 0.1, model.nv)
        image.qpos[:], image.qvel[:] = images.qpos(robot.qpos), images.qvel(robot.qvel)
        for step in range(10):
            control = rng.normal(0, 0.2, model.nu)
            robot.ctrl[:] = offset + factor * control
            image.ctrl[:] = offset + factor * control[group.control_index[number]] * group.control_sign[number]
            for data in (robot, image):
                mujoco.mj_step(model, data, 5)
            contacts += robot.ncon
            qpos, qvel = images.qpos(robot.qpos), images.qvel(robot.qvel)
            qpos[3:7] *= np.sign(qpos[3:7] @ image.qpos[3:7])  # a rotation has two quaternions
            gap = max(np.abs(qpos - image.qpos).max(), np.abs(qvel - image.qvel).max())
            assert gap < (tolerance if step else tolerance / 100), (number, step)
        assert contacts > 10


KINDS = [
    ("ant", "rotation", 4),
    ("ant", "dihedral", 8),
    ("ant", None, 1),
    *((name, "dihedral", None) for name in MOVED),
]


@pytest.mark.parametrize(("name", "kind", "equal"), KINDS)
def test_a_primitive_acts_in_images_of_its_group_as_in_the_world(tmp_path, name, kind, equal):
    """And in no other image: in none without a symmetry, in no reflection with the rotations only.

    The worlds are rotated by any angle, which the egocentric view does not depend on.
    """
    body, rng = make(tmp_path, name), np.random.default_rng(6)
    model, group = on_a_floor(body), body.symmetry(is_mirrored=kind == "dihedral") if kind else None
    nq, size = model.nq, model.nq + model.nv
    view, own = EgocentricView(body, range(size)), elements(group.num_turns if group else 4)
    worlds = [turned(rng.uniform(-np.pi, np.pi)) @ MIRRORS[number * 2 // len(own)] for number in range(len(own))]
    images = [Images(model, *each) for each in ((np.eye(3), np.eye(3)), *zip(worlds, own, strict=True))]
    num_inputs = AngleEncoding.size + view.size(size)
    design = GoalDesign(
        networks={"primitive": MLP(num_inputs, (16, 16), len(body.controls))},
        primitive_view=view,
        symmetry=group,
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_interval=4,
        control_limit=1.0,
    )
    agent = design.agent(design, 1, len(images))
    theta = design.networks["primitive"].initial(rng, "glorot_normal") * 2
    statistics = ObservationStatistics.empty(num_inputs).merge(
        9, rng.normal(size=num_inputs), np.full(num_inputs, 20.0)
    )
    agent.centre_on((LevelParameters.of(theta, statistics),))
    agent.levels[0].theta[0] = theta
    agent.start(slice(None))
    found = []
    for step in range(12):
        qpos, qvel = model.qpos0 + rng.normal(0, 0.3, nq), rng.normal(size=model.nv)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        if step % 4 == 0:
            place = qpos[:2] + rng.uniform(-4, 4, 2)
        seen = np.array([np.concatenate([each.qpos(qpos), each.qvel(qvel)]) for each in images])
        goal = np.array([each.point(place) for each in images])
        found.append(agent.act(AgentInputs(seen, seen[:, :2].copy(), body.heading(seen[:, :nq]), goal)).copy())
    base, *controls = np.array(found).swapaxes(0, 1)
    assert np.ptp(base, axis=0).min() > 0.01
    for number, (image, acted) in enumerate(zip(images[1:], controls, strict=True)):
        gap = np.abs(acted - [image.ctrl(control) for control in base]).max()
        assert gap < 1e-6 if number < (equal or len(own)) else gap > 0.01
