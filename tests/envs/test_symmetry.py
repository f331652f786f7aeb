"""The symmetry of the ant: equal motion in MuJoCo, and equal actions, in a rotated or reflected world.

A world is rotated about the vertical, or reflected (y -> -y), by an orthogonal matrix S. The ant's symmetry T maps its
body onto itself and every leg onto another: an ant of pose R in the first world looks like one of pose S R T^-1, with
permuted legs, in the second. `Images` derives this from the model's geometry alone, not from the body's tables.
"""

import itertools

import mujoco
import numpy as np
import pytest

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

GROUPS = {"rotation": Ant().symmetry(is_mirrored=False), "dihedral": Ant().symmetry(is_mirrored=True)}


def turned(angle):
    """Return the rotation [3, 3] about the vertical by `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def quarters(number):
    """Return the exact rotation by `number` quarter turns to the left."""
    return np.rint(turned(number * np.pi / 2))


MIRRORS = np.eye(3), np.diag([1.0, -1.0, 1.0])
ELEMENTS = tuple(quarters(k) @ mirror for mirror in MIRRORS for k in range(4))
"""The symmetry of the ant's body: four turns to the left, and each of them after a mirroring."""


def ant_model(integrator="euler"):
    """Return an ant on an infinite floor."""
    spec = empty_world("ant", integrator)
    Ant().add_to(spec)
    return spec.compile()


class Images:
    """Images of states, controls and goals of `model`, an ant whose hinges follow its free joint in qpos and qvel."""

    def __init__(self, model, world, element):
        """Map by `world` [3, 3] and the body's `element` [3, 3]: both rotations or both reflections."""
        assert np.isclose(np.linalg.det(world), np.linalg.det(element))
        self.model, self.world, self.element = model, world, element
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)  # all legs stretched, the torso upright: places and axes are the torso's
        places, axes = data.xanchor[1:] - data.xpos[model.body("torso").id], data.xaxis[1:]
        # An axis of rotation is a pseudovector.
        there, around = places @ element.T, np.linalg.det(element) * axes @ element.T
        is_image = np.isclose(places[:, None], there).all(axis=2) & np.isclose(np.abs(axes @ around.T), 1)
        assert (is_image.sum(axis=1) == 1).all()
        self.source = is_image.argmax(axis=1)
        self.sign = np.rint((axes @ around.T)[range(len(axes)), self.source])

    def qpos(self, qpos):
        rotation, quaternion = np.zeros(9), np.zeros(4)
        mujoco.mju_quat2Mat(rotation, qpos[3:7])
        mujoco.mju_mat2Quat(quaternion, (self.world @ rotation.reshape(3, 3) @ self.element.T).ravel())
        return np.concatenate([self.world @ qpos[:3], quaternion, self._hinge(qpos[7:])])

    def qvel(self, qvel):
        # MuJoCo gives the torso's rotation about its own axes: a pseudovector.
        spin = np.linalg.det(self.element) * self.element @ qvel[3:6]
        return np.concatenate([self.world @ qvel[:3], spin, self._hinge(qvel[6:])])

    def ctrl(self, ctrl):
        joints = self.model.jnt_qposadr[self.model.actuator_trnid[:, 0]] - 7
        by_hinge = np.zeros(len(joints))
        by_hinge[joints] = ctrl
        return self._hinge(by_hinge)[joints]

    def point(self, place):
        """Return the image of a position or direction on the ground [2]."""
        return self.world[:2, :2] @ place

    def _hinge(self, values):
        return self.sign * values[self.source]


@pytest.mark.parametrize("group", GROUPS.values(), ids=GROUPS)
def test_every_goal_is_turned_ahead_and_mirrored_to_the_left(group):
    angles = np.deg2rad(np.concatenate([np.arange(-180, 181, 1.5), np.arange(-180, 181, 45.0)]))
    radius = np.random.default_rng(2).uniform(0.01, 9, len(angles))
    goals = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    frames = Frames(group, len(goals))
    frames.choose(slice(None), goals)
    ahead, left = frames.turned(goals).T
    bearing = np.rad2deg(np.arctan2(left, ahead))
    assert np.hypot(ahead, left) == pytest.approx(radius)
    assert np.abs(bearing).max() <= 45 + 1e-9
    assert bearing.min() >= -1e-9 if group.is_mirrored else bearing.min() < -22.5
    assert bearing.max() > 22.5
    assert set(group.choose(*goals.T)) == set(range(len(group.view_index)))


@pytest.mark.parametrize("element", range(len(ELEMENTS)))
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_the_motion_in_an_image_of_the_world_is_the_image(integrator, element):
    """In the world rotated like the body's element, and in one rotated by a further quarter turn.

    MuJoCo processes the contacts of an image in another order, so the motions differ by rounding. A wrong sign shows in
    the first step, by a hundredth or more.
    """
    model, group = ant_model(integrator), GROUPS["dihedral"]
    for seed, further in itertools.product((0, 1), (0, 1)):
        images = Images(model, quarters(further) @ ELEMENTS[element], ELEMENTS[element])
        robot, image, rng, contacts = mujoco.MjData(model), mujoco.MjData(model), np.random.default_rng(seed), 0
        half = rng.uniform(-np.pi, np.pi) / 2
        robot.qpos[2:7] = [0.55, np.cos(half), 0, 0, np.sin(half)]
        robot.qpos[7:], robot.qvel[:] = model.jnt_range[1:].mean(axis=1), rng.normal(0, 0.1, model.nv)
        image.qpos[:], image.qvel[:] = images.qpos(robot.qpos), images.qvel(robot.qvel)
        for step in range(10):
            robot.ctrl[:] = rng.normal(0, 5, model.nu)
            image.ctrl[:] = robot.ctrl[group.control_index[element]] * group.control_sign[element]
            for data in (robot, image):
                mujoco.mj_step(model, data, 5)
            contacts += robot.ncon
            qpos, qvel = images.qpos(robot.qpos), images.qvel(robot.qvel)
            qpos[3:7] *= np.sign(qpos[3:7] @ image.qpos[3:7])  # a rotation has two quaternions
            gap = max(np.abs(qpos - image.qpos).max(), np.abs(qvel - image.qvel).max())
            assert gap < (1e-9 if step else 1e-12), (seed, further, step)
        assert contacts > 10


@pytest.mark.parametrize(("kind", "equal"), [("rotation", 4), ("dihedral", 8), (None, 1)])
def test_a_primitive_acts_in_images_of_its_group_as_in_the_world(kind, equal):
    """And in no other image: in none without a symmetry, in no reflection with the rotations only.

    The worlds are rotated by any angle, which the egocentric view does not depend on.
    """
    rng, model, view = np.random.default_rng(6), ant_model(), EgocentricView(Ant(), range(29))
    worlds = [turned(rng.uniform(-np.pi, np.pi)) @ MIRRORS[element // 4] for element in range(len(ELEMENTS))]
    images = [Images(model, *each) for each in ((np.eye(3), np.eye(3)), *zip(worlds, ELEMENTS, strict=True))]
    design = GoalDesign(
        networks={"primitive": MLP(AngleEncoding.size + view.size(29), (16, 16), len(Ant.controls))},
        primitive_view=view,
        symmetry=GROUPS.get(kind),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_interval=4,
        control_limit=1.0,
    )
    agent = design.agent(design, 1, len(images))
    theta = design.networks["primitive"].initial(rng, "glorot_normal") * 2
    statistics = ObservationStatistics.empty(28).merge(9, rng.normal(size=28), np.full(28, 20.0))
    agent.centre_on((LevelParameters.of(theta, statistics),))
    agent.levels[0].theta[0] = theta
    agent.start(slice(None))
    found = []
    for step in range(12):
        qpos, qvel = model.qpos0 + rng.normal(0, 0.3, model.nq), rng.normal(size=model.nv)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        if step % 4 == 0:
            place = qpos[:2] + rng.uniform(-4, 4, 2)
        seen = np.array([np.concatenate([each.qpos(qpos), each.qvel(qvel)]) for each in images])
        goal = np.array([each.point(place) for each in images])
        found.append(agent.act(AgentInputs(seen, seen[:, :2].copy(), Ant().heading(seen[:, :15]), goal)).copy())
    base, *controls = np.array(found).swapaxes(0, 1)
    assert np.ptp(base, axis=0).min() > 0.01
    for number, (image, own) in enumerate(zip(images[1:], controls, strict=True)):
        gap = np.abs(own - [image.ctrl(control) for control in base]).max()
        assert gap < 1e-6 if number < equal else gap > 0.01
