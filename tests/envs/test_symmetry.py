"""The symmetry of bodies: group laws, and equal motion in MuJoCo in a rotated or reflected world.

Rounding: MuJoCo processes the contacts of an image in another order, so the motions differ by about 1e-15 after the
first step and by 1e-13, in unlucky states 1e-11, after ten control steps. A wrong sign shows in the first step, by a
hundredth or more.
"""

import itertools
from functools import cache
from types import SimpleNamespace

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
from shes.envs.named_environments import ENVIRONMENTS
from shes.envs.worlds import empty_world
from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from tests.envs.legs import ELEMENTS, MIRROR, Images, quarters, turned

BODIES = {body.name: body() for body in {environment.body for environment in ENVIRONMENTS.values()}}
GROUPS = {
    f"{name}, {kind}": group
    for name, body in sorted(BODIES.items())
    for kind, is_mirrored in (("rotation", False), ("dihedral", True))
    if (group := body.symmetry(is_mirrored=is_mirrored)) is not None
}
DIHEDRAL = GROUPS["ant, dihedral"]
over_groups = pytest.mark.parametrize("group", [pytest.param(group, id=name) for name, group in GROUPS.items()])


def directions(group):
    """Return the matrix [G, 2, 2] of each element for vectors (ahead, left)."""
    return np.array([[[c, s], [-m * s, m * c]] for c, s, m in zip(*group.direction(), strict=True)])


@over_groups
def test_every_goal_is_turned_ahead_and_mirrored_to_the_left(group):
    angles = np.deg2rad(np.concatenate([np.arange(-180, 181, 1.5), np.arange(-180, 181, 45.0)]))
    radius = np.random.default_rng(2).uniform(0.01, 9, len(angles))
    goals = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    frames = Frames(group, len(goals))
    frames.choose(slice(None), goals)
    ahead, left = frames.turned(goals).T
    bearing = np.rad2deg(np.arctan2(left, ahead))
    assert np.abs(bearing).max() <= 45 + 1e-9
    assert bearing.min() >= -1e-9 if group.is_mirrored else bearing.min() < -22.5
    assert bearing.max() > 22.5
    expected = np.einsum("nij,nj->ni", directions(group)[group.choose(*goals.T)], goals)
    assert frames.turned(goals) == pytest.approx(expected, abs=1e-12)
    assert set(group.choose(*goals.T)) == set(range(group.num_elements))


@over_groups
def test_frames_are_chosen_for_the_robots_asked_for(group):
    rng, frames = np.random.default_rng(3), Frames(group, 3)
    frames.set(slice(None), np.full(3, group.num_elements - 1))
    vectors, values = rng.normal(size=(3, 2)), rng.normal(size=(3, group.view_index.shape[1]))
    before, after = np.empty_like(values), np.empty_like(values)
    frames.view(values, before)
    frames.choose(np.array([1]), np.array([[1.0, 0.01]]))  # ahead: the robot's own frame
    frames.view(values, after)
    assert after[1].tolist() == values[1].tolist() != before[1].tolist()
    assert after[[0, 2]].tolist() == before[[0, 2]].tolist()
    assert frames.turned(vectors)[1].tolist() == vectors[1].tolist()


# Physics -------------------------------------------------------------------------------------------------------------


@cache
def ant_model(integrator="euler"):
    """Return an ant on an infinite floor."""
    spec = empty_world("ant", integrator)
    Ant().add_to(spec)
    return spec.compile()


def look(qpos, qvel):
    """Return the ant's egocentric view [25]."""
    out = np.zeros((1, len(Ant.egocentric)))
    Ant().write_egocentric(qpos[None], qvel[None], Ant().frame_angle(qpos[None]), out)
    return out[0]


def move(data, control):
    data.ctrl[:] = control
    mujoco.mj_step(data.model, data, 5)


@cache
def motion(integrator, seed, steps=10):
    """Return qpos [T + 1, 15], qvel [T + 1, 14] and controls [T, 8] of an ant with any heading that crawls.

    It has landed with at least three feet on the ground. `warmstart` [14] is what the solver begins with. The policy is
    random, and weak enough to stay on its feet.
    """
    data, rng = mujoco.MjData(ant_model(integrator)), np.random.default_rng(seed)
    gains = rng.normal(0, 0.6, (Ant().num_controls, len(Ant.egocentric)))
    half = rng.uniform(-np.pi, np.pi) / 2
    data.qpos[3:7] = [np.cos(half), 0, 0, np.sin(half)]
    data.qpos[7:] = data.model.jnt_range[1:].mean(axis=1)
    data.qvel[:] = rng.normal(0, 0.1, data.model.nv)
    found, landed, contacts = SimpleNamespace(model=data.model, qpos=[], qvel=[], controls=[]), False, 0
    for step in range(60 + steps):
        if not landed and step >= 10 and data.ncon >= 3:
            landed, found.warmstart = True, data.qacc_warmstart.copy()
        if landed:
            found.qpos.append(data.qpos.copy())
            found.qvel.append(data.qvel.copy())
            contacts += data.ncon
            if len(found.qpos) > steps:
                break
        control = 0.4 * Ant.control_limit * np.tanh(gains @ look(data.qpos, data.qvel))
        found.controls += [control] * landed
        move(data, control)
    assert len(found.qpos) == steps + 1 < contacts
    return found


def gaps_of(found, element, images, steps=10):
    """Return the distance between an ant and the image of the one in motion `found`, after each control step.

    The ant starts as the image. Its controls are mapped by an agent that acts in the frame of this element.
    """
    data, gaps = mujoco.MjData(found.model), []
    data.qpos[:], data.qvel[:] = images.qpos(found.qpos[0]), images.qvel(found.qvel[0])
    data.qacc_warmstart[:] = images.qvel(found.warmstart)
    for step in range(steps):
        move(data, found.controls[step][DIHEDRAL.control_index[element]] * DIHEDRAL.control_sign[element])
        qpos, qvel = images.qpos(found.qpos[step + 1]), images.qvel(found.qvel[step + 1])
        qpos[3:7] *= np.sign(qpos[3:7] @ data.qpos[3:7])  # a rotation has two quaternions
        gaps.append(max(np.abs(qpos - data.qpos).max(), np.abs(qvel - data.qvel).max()))
    return np.array(gaps)


@pytest.mark.parametrize("element", range(len(ELEMENTS)))
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_the_motion_in_an_image_of_the_world_is_the_image(integrator, element):
    """In the world rotated like the body's element, and in one rotated by a further quarter turn."""
    for seed, further in itertools.product((0, 1), (0, 1)):
        found = motion(integrator, seed)
        gaps = gaps_of(found, element, Images(found.model, quarters(further) @ ELEMENTS[element], ELEMENTS[element]))
        assert gaps[0] < 1e-12
        assert gaps.max() < 1e-9


def test_no_other_element_gives_the_same_motion():
    found = motion("euler", 0)
    for made, used in itertools.product(range(len(ELEMENTS)), repeat=2):
        (gap,) = gaps_of(found, used, Images(found.model, ELEMENTS[made], ELEMENTS[made]), steps=1)
        assert gap < 1e-12 if made == used else gap > 1e-2


# Through what agents use ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def states():
    """Return the states of a crawling ant after each step, [T, 15] and [T, 14], for three goals' intervals."""
    found = motion("euler", 4, steps=12)
    return np.array(found.qpos[:-1]), np.array(found.qvel[:-1])


def all_images():
    """Return the eight images in worlds rotated by any angle, which the egocentric view does not depend on."""
    angles = np.random.default_rng(5).uniform(-np.pi, np.pi, len(ELEMENTS))
    worlds = [turned(angle) @ mirror for angle, mirror in zip(angles, [np.eye(3)] * 4 + [MIRROR] * 4, strict=True)]
    return [Images(ant_model(), *each) for each in zip(worlds, ELEMENTS, strict=True)]


def test_an_image_looks_the_same_from_the_frame_of_its_element(states):
    images, frames = all_images(), Frames(DIHEDRAL, len(ELEMENTS))
    frames.set(slice(None), np.arange(len(images)))
    for qpos, qvel in zip(*states, strict=True):
        own = np.array([look(each.qpos(qpos), each.qvel(qvel)) for each in images])
        seen = np.zeros_like(own)
        frames.view(own, seen)
        assert seen == pytest.approx(np.tile(look(qpos, qvel), (len(seen), 1)), abs=1e-12)
        assert np.abs(seen[0]).min() > 0  # a sign of every value shows


@pytest.mark.parametrize(("kind", "equal"), [("rotation", 4), ("dihedral", 8), (None, 1)])
def test_a_primitive_acts_in_images_of_its_group_as_in_the_world(states, kind, equal):
    """And in no other image: in none without a symmetry, in no reflection with the rotations only."""
    view, images = EgocentricView(Ant(), range(29)), [Images(ant_model(), np.eye(3), np.eye(3)), *all_images()]
    design = GoalDesign(
        primitive=MLP(AngleEncoding.size + view.size(29), (16, 16), Ant().num_controls),
        primitive_view=view,
        symmetry=GROUPS.get(f"ant, {kind}"),
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_interval=4,
        control_limit=1.0,
    )
    agent, rng = design.make(1, len(images)), np.random.default_rng(6)
    theta = design.primitive.initial(rng, "glorot_normal") * 2
    statistics = ObservationStatistics.empty(28).merge(9, rng.normal(size=28), np.full(28, 20.0))
    agent.centre_on((LevelParameters.of(theta, statistics),))
    agent.levels[0].theta[0] = theta
    agent.start(slice(None))
    goals, found = states[0][::4, :2] + rng.uniform(-4, 4, (3, 2)), []
    for step, (qpos, qvel) in enumerate(zip(*states, strict=True)):
        seen = np.array([np.concatenate([each.qpos(qpos), each.qvel(qvel)]) for each in images])
        goal = np.array([each.point(goals[step // 4]) for each in images])
        found.append(agent.act(AgentInputs(seen, seen[:, :2].copy(), Ant().heading(seen[:, :15]), goal)).copy())
    base, *controls = np.array(found).swapaxes(0, 1)
    assert np.ptp(base, axis=0).min() > 0.01
    for number, (image, own) in enumerate(zip(images[1:], controls, strict=True)):
        gap = np.abs(own - [image.ctrl(control) for control in base]).max()
        assert gap < 1e-6 if number < equal else gap > 0.01
