"""The symmetry of bodies: group laws, and equal motion in MuJoCo in a rotated or reflected world.

Rounding: MuJoCo processes the contacts of an image in another order, sums in another order, and its solver stops within
a tolerance, so the motions differ by about 1e-15 after the first step. After ten control steps (fifty physics steps)
they differ by 1e-13, in unlucky states by 1e-11. Later they diverge: rounding decides whether a foot touches the ground
in one step or the next, and contacts amplify the difference. This is chaos, not a broken symmetry: a wrong sign shows
in the first step, by a hundredth or more.
"""

import itertools
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from shes.agents.frames import Frames
from shes.agents.goal_agent import GoalDesign
from shes.agents.goals import AngleEncoding
from shes.agents.mlp import MLP
from shes.agents.rewards import ProgressReward
from shes.agents.views import EgocentricView
from shes.envs.bodies.ant import Ant
from shes.envs.registry import ENVIRONMENTS
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
over_groups = pytest.mark.parametrize("group", [pytest.param(group, id=name) for name, group in GROUPS.items()])
STARTS = 2
CONTROL_STEPS = 10
PHYSICS_STEPS = 5


# Laws of groups ------------------------------------------------------------------------------------------------------


def _matrices(index, sign):
    """Return the signed permutations [G, V, V] as matrices."""
    size = index.shape[1]
    found = np.zeros((len(index), size, size))
    for element, (places, signs) in enumerate(zip(index, sign, strict=True)):
        found[element, range(size), places] = signs
    return found


def _directions(group):
    """Return the matrix [G, 2, 2] of each element for vectors (ahead, left)."""
    return np.array([[[c, s], [-m * s, m * c]] for c, s, m in zip(*group.direction(), strict=True)])


def _place(matrices, wanted):
    (found,) = [i for i, each in enumerate(matrices) if np.array_equal(each, wanted)]
    return found


def test_the_ant_alone_has_a_symmetry():
    assert {name: (group.num_elements, group.num_turns, group.is_mirrored) for name, group in GROUPS.items()} == {
        "ant, rotation": (4, 4, False),
        "ant, dihedral": (8, 4, True),
    }


@over_groups
def test_elements_are_signed_permutations_and_no_two_are_the_same(group):
    for index, sign in ((group.view_index, group.view_sign), (group.control_index, group.control_sign)):
        assert index.shape == sign.shape
        assert len(index) == group.num_elements
        assert (np.sort(index, axis=1) == np.arange(index.shape[1])).all()
        assert set(sign.ravel()) <= {-1.0, 1.0}
        assert len({each.tobytes() for each in _matrices(index, sign)}) == group.num_elements


@over_groups
def test_view_controls_and_vectors_compose_alike(group):
    views, directions = _matrices(group.view_index, group.view_sign), _directions(group)
    controls = [back.T for back in _matrices(group.control_index, group.control_sign)]  # from the robot to the frame
    for one, other in itertools.product(range(group.num_elements), repeat=2):
        third = _place(directions, directions[other] @ directions[one])
        assert _place(views, views[other] @ views[one]) == third
        assert _place(controls, controls[other] @ controls[one]) == third


@over_groups
def test_controls_that_a_frame_chose_come_back_to_the_robot(group):
    """Mapping controls into an element's frame and back returns them."""
    rng = np.random.default_rng(1)
    frames = Frames(group, group.num_elements)
    frames.set(slice(None), np.arange(group.num_elements))
    own = rng.normal(size=(group.num_elements, group.control_index.shape[1])).astype(np.float32)
    seen = np.array([own[e] @ _matrices(group.control_index, group.control_sign)[e] for e in range(len(own))])
    assert frames.controls(seen.astype(np.float32)).tolist() == own.tolist()


# Which frame is chosen -----------------------------------------------------------------------------------------------


def _goals():
    """Return goals in all directions [N, 2] and their angles in degrees, with the borders between frames."""
    angles = np.concatenate([np.arange(-180, 181, 1.5), np.arange(-180, 181, 45.0)])
    radius = np.random.default_rng(2).uniform(0.01, 9, len(angles))
    return np.stack([radius * np.cos(np.deg2rad(angles)), radius * np.sin(np.deg2rad(angles))], axis=1), radius


@over_groups
def test_every_goal_is_turned_ahead_and_mirrored_to_the_left(group):
    goals, radius = _goals()
    frames = Frames(group, len(goals))
    frames.choose(slice(None), goals)
    ahead, left = frames.turned(goals).T
    bearing = np.rad2deg(np.arctan2(left, ahead))
    half = 180 / group.num_turns
    assert half == 45
    assert np.abs(bearing).max() <= half + 1e-9
    if group.is_mirrored:
        assert bearing.min() >= -1e-9
    else:
        assert bearing.min() < -half / 2 < half / 2 < bearing.max()
    assert np.hypot(ahead, left) == pytest.approx(radius, rel=1e-12)
    expected = np.einsum("nij,nj->ni", _directions(group)[group.choose(*goals.T)], goals)
    assert frames.turned(goals) == pytest.approx(expected, abs=1e-12)
    assert set(group.choose(*goals.T)) == set(range(group.num_elements))


@over_groups
def test_frames_are_chosen_for_the_robots_asked_for(group):
    rng, last = np.random.default_rng(3), group.num_elements - 1
    frames = Frames(group, 3)
    frames.set(slice(None), np.full(3, last))
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
def _model(integrator="euler"):
    """Return an ant on an infinite floor."""
    spec = empty_world("ant", integrator)
    Ant().add_to(spec)
    return spec.compile()


def _policy(seed):
    """Return a random policy from the egocentric view to the controls of the ant, weak enough to stay on its feet."""
    gains = np.random.default_rng(seed).normal(0, 0.6, (Ant().num_controls, len(Ant.egocentric)))
    return lambda view: 0.4 * Ant.control_limit * np.tanh(gains @ view)


def _view(qpos, qvel):
    """Return the ant's egocentric view [25]."""
    out = np.zeros((1, len(Ant.egocentric)))
    Ant().write_egocentric(qpos[None], qvel[None], Ant().frame_angle(qpos[None]), out)
    return out[0]


def _step(data, control):
    data.ctrl[:] = control
    for _ in range(PHYSICS_STEPS):
        mujoco.mj_step(data.model, data)


def _settled(model, seed):
    """Return an ant that has landed and crawls, with at least three feet on the ground and any heading."""
    data, rng, act = mujoco.MjData(model), np.random.default_rng(seed), _policy([seed, 1])
    data.qpos[:3] = model.qpos0[:3]
    half = rng.uniform(-np.pi, np.pi) / 2
    data.qpos[3:7] = [np.cos(half), 0, 0, np.sin(half)]
    data.qpos[7:] = model.jnt_range[1:].mean(axis=1)
    data.qvel[:] = rng.normal(0, 0.1, model.nv)
    for step in range(60):
        _step(data, act(_view(data.qpos, data.qvel)))
        if step >= 10 and data.ncon >= 3:
            break
    assert data.ncon >= 3
    assert not Ant().fallen(data.qpos[None])[0]
    return data


class Motion(NamedTuple):
    """The motion of an ant in some control steps, from a state with feet on the ground."""

    model: mujoco.MjModel
    warmstart: np.ndarray
    """What its solver begins with [14]."""
    qpos: np.ndarray
    """Where it is [T + 1, 15]."""
    qvel: np.ndarray
    """How it moves [T + 1, 14]."""
    controls: np.ndarray
    """What a random policy that sees its own frame does [T, 8]."""


@cache
def _motion(integrator, seed, steps=CONTROL_STEPS):
    model = _model(integrator)
    data, act = _settled(model, seed), _policy([seed, 2])
    warmstart, qpos, qvel, controls, contacts = data.qacc_warmstart.copy(), [], [], [], []
    for _ in range(steps):
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
        controls.append(act(_view(data.qpos, data.qvel)))
        _step(data, controls[-1])
        contacts.append(data.ncon)
    assert np.mean(contacts) > 1
    return Motion(model, warmstart, *map(np.array, ([*qpos, data.qpos], [*qvel, data.qvel], controls)))


def _gaps(motion, group, element, images, steps=CONTROL_STEPS):
    """Return the distance between an ant and the image of the one in `motion`, after each control step.

    The ant starts as the image. Its controls are those of the motion, mapped by an agent that acts in the frame of this
    element.
    """
    data = mujoco.MjData(motion.model)
    data.qpos[:], data.qvel[:] = images.qpos(motion.qpos[0]), images.qvel(motion.qvel[0])
    data.qacc_warmstart[:] = images.qvel(motion.warmstart)
    gaps = []
    for step in range(steps):
        _step(data, motion.controls[step][group.control_index[element]] * group.control_sign[element])
        qpos, qvel = images.qpos(motion.qpos[step + 1]), images.qvel(motion.qvel[step + 1])
        qpos[3:7] *= np.sign(qpos[3:7] @ data.qpos[3:7])  # a rotation has two quaternions
        gaps.append(max(np.abs(qpos - data.qpos).max(), np.abs(qvel - data.qvel).max()))
    return np.array(gaps)


@pytest.mark.parametrize("element", range(len(ELEMENTS)))
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_the_motion_in_an_image_of_the_world_is_the_image(integrator, element):
    """In the world rotated like the body's element, and in one rotated by a further quarter turn."""
    for seed, further in itertools.product(range(STARTS), (0, 1)):
        motion = _motion(integrator, seed)
        images = Images(motion.model, quarters(further) @ ELEMENTS[element], ELEMENTS[element])
        gaps = _gaps(motion, GROUPS["ant, dihedral"], element, images)
        assert gaps[0] < 1e-12
        assert gaps.max() < 1e-9


def test_no_other_element_gives_the_same_motion():
    motion = _motion("euler", 0)
    for made, used in itertools.product(range(len(ELEMENTS)), repeat=2):
        images = Images(motion.model, ELEMENTS[made], ELEMENTS[made])
        (gap,) = _gaps(motion, GROUPS["ant, dihedral"], used, images, steps=1)
        assert gap < 1e-12 if made == used else gap > 1e-2


# Through what agents use ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def states():
    """Return the states of a crawling ant after each step, [T, 15] and [T, 14], for three goals' intervals."""
    motion = _motion("euler", 4, steps=12)
    return motion.qpos[:-1], motion.qvel[:-1]


def _all_images():
    """Return the eight images in worlds rotated by any angle, which the egocentric view does not depend on."""
    angles = np.random.default_rng(5).uniform(-np.pi, np.pi, len(ELEMENTS))
    mirrors = [np.eye(3)] * 4 + [MIRROR] * 4
    return [
        Images(_model(), turned(angle) @ mirror, element)
        for angle, mirror, element in zip(angles, mirrors, ELEMENTS, strict=True)
    ]


def _seen_by_elements(group, images, qpos, qvel):
    """Return the egocentric views [G, 25] of the images, each in the frame of its element."""
    own = np.array([_view(each.qpos(qpos), each.qvel(qvel)) for each in images])
    frames, seen = Frames(group, len(images)), np.zeros_like(own)
    frames.set(slice(None), np.arange(len(images)))
    frames.view(own, seen)
    return seen


def test_an_image_looks_the_same_from_the_frame_of_its_element(states):
    group, images = GROUPS["ant, dihedral"], _all_images()
    for qpos, qvel in zip(*states, strict=True):
        seen = _seen_by_elements(group, images, qpos, qvel)
        assert seen == pytest.approx(np.tile(_view(qpos, qvel), (len(seen), 1)), abs=1e-12)
        assert np.abs(seen[0]).min() > 0  # a sign of every value shows


@pytest.mark.parametrize("body", [body for body in BODIES.values() if body.quaternion is not None])
def test_no_element_changes_the_angle_of_the_frame(states, body):
    """The heading is not such an angle: seen from above, a tilted torso's axes are not a quarter turn apart."""
    tilted = states[0][:1].copy()
    tilted[0, 3:7] = [np.cos(0.3), 0.8 * np.sin(0.3), 0.6 * np.sin(0.3), 0]

    def differences(angle):
        own = angle(tilted)[0]
        return [
            np.abs(np.exp(1j * (angle(Images(_model(), e, e).qpos(tilted[0])[None])[0] - np.linalg.det(e) * own)) - 1)
            for e in ELEMENTS
        ]

    assert max(differences(body.frame_angle)) < 1e-12
    assert max(differences(body.heading)) > 0.01


def _design(group):
    view = EgocentricView(Ant(), range(29))
    return GoalDesign(
        primitive=MLP(AngleEncoding.size + view.size(29), (16, 16), Ant().num_controls),
        primitive_view=view,
        symmetry=group,
        goal_encoding=AngleEncoding(),
        primitive_reward=ProgressReward(),
        controller_interval=4,
        control_limit=1.0,
    )


def _controls(group, images, states, goals):
    """Return the controls [T, N, 8] that one random network chooses for all images of an ant, in each step."""
    design = _design(group)
    agent = design.make(1, len(images))
    theta = design.primitive.initial(np.random.default_rng(6), "glorot_normal") * 2
    statistics = ObservationStatistics.empty(28).merge(9, np.random.default_rng(7).normal(size=28), np.full(28, 20.0))
    agent.normalise_by((LevelParameters.of(theta, statistics),))
    agent.theta[0][0] = theta
    agent.start(slice(None))
    found = []
    for step, (qpos, qvel) in enumerate(zip(*states, strict=True)):
        seen = np.array([np.concatenate([each.qpos(qpos), each.qvel(qvel)]) for each in images])
        goal = np.array([each.point(goals[step // 4]) for each in images])
        heading = Ant().heading(seen[:, :15])
        found.append(agent.act(seen, seen[:, :2].copy(), heading, goal=goal).copy())
    return np.array(found)


@pytest.mark.parametrize("kind", ["rotation", "dihedral"])
@pytest.mark.parametrize("seed", range(STARTS))
def test_a_primitive_acts_in_the_image_of_a_world_as_in_the_world(states, kind, seed):
    group = GROUPS[f"ant, {kind}"]
    images = _all_images()[: group.num_elements]
    goals = states[0][::4, :2] + np.random.default_rng(seed).uniform(-4, 4, (3, 2))
    controls = _controls(group, images, states, goals)
    base = _controls(group, [Images(_model(), np.eye(3), np.eye(3))], states, goals)[:, 0]
    assert np.ptp(base, axis=0).min() > 0.01
    for number, each in enumerate(images):
        assert controls[:, number] == pytest.approx(np.array([each.ctrl(control) for control in base]), abs=1e-6)


@pytest.mark.parametrize(("kind", "first"), [(None, 1), ("rotation", 4)])
def test_a_primitive_without_the_elements_does_not(states, kind, first):
    """Not without a symmetry, and not for reflections with the rotations only."""
    images = _all_images()[first:]
    goals = states[0][::4, :2] + np.random.default_rng(0).uniform(-4, 4, (3, 2))
    group = GROUPS.get(f"ant, {kind}")
    controls = _controls(group, images, states, goals)
    base = _controls(group, [Images(_model(), np.eye(3), np.eye(3))], states, goals)[:, 0]
    for number, each in enumerate(images):
        assert np.abs(controls[:, number] - np.array([each.ctrl(control) for control in base])).max() > 0.01
