"""Robots do not pass through walls, platforms or the block, and the block does not enter walls or platforms.

Robots start close to a wall, the block, a corner or an edge, move towards it at up to 10 m/s and act at the limit. The
penetration is measured after every physics step by geometry alone, independently of MuJoCo's contacts: all boxes are
axis-aligned. The ant is represented by its torso's centre and its feet, which reach furthest. (At 11 m/s a robot cannot
cross a box of 8 m within 0.02 s.)
"""

from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from shes.envs.named_environments import ENVIRONMENTS, find_environment, make_task
from shes.envs.tasks.task import FRAME_SKIP
from shes.envs.worlds import INTEGRATORS
from shes.sim.simulator import CpuSimulator

WORLDS = [(name, "shes") for name in ENVIRONMENTS if not name.endswith("-flagrun")]  # which has Gather's
WORLDS += [("point-gather", "hiro"), ("ant-gather", "hiro")]  # the only ones with other walls
CLEARANCE_M = {"point": 0.3, "ant": 0.95}
"""How far from walls and block the robot's centre starts at least: an ant's feet are 0.9 m ahead of it."""
TOUCH_M = {"robot": 0.27, "foot": 0.1}
"""Radius of the point or of an ant's foot, and the contact margin: nearer than this it touches."""
ALLOWED_M = {
    # The robot's centre: of the point's sphere or the ant's torso, another sphere of 0.25 m.
    **dict.fromkeys(("robot in wall", "robot over wall", "robot in platform", "robot under ground"), 0.0),
    # A block of 0.2 g is soft: a point that hits it when a wall is behind it gets its centre 0.35 m in.
    "robot in block": 0.5,
    # 0.25 m at most in a thousand episodes of any task and integrator.
    **dict.fromkeys(("block in wall", "block in platform", "block under ground"), 0.4),
    # 0.28 m at most in a thousand episodes; in the block 0.54 m, of the 4 m to its centre plane.
    **dict.fromkeys(("foot in wall", "foot in platform"), 0.4),
    "foot in block": 0.8,
}
"""How deep they may be in each other at most."""
ALLOWED_AT_REST_M = {"robot in block": 0.0, "foot in block": 0.1, "foot in wall": 0.0, "foot in platform": 0.0}
"""The same after a second without a control; an ant may lean against the block (its feet: 0.04 m in a thousand)."""


@cache
class Boxes:
    """The boxes of a model whose name begins with `prefix`: centres and half sizes [B, 3]."""

    def __init__(self, model, prefix):
        found = [model.geom(i) for i in range(model.ngeom) if model.geom(i).name.startswith(prefix)]
        self.center, self.half = np.array([[geom.pos, geom.size] for geom in found]).reshape(-1, 2, 3).swapaxes(0, 1)

    def depth(self, center, half=0.0, height=0.0):
        """Return the largest depth [N] of points or boxes at `center` [N, 3] in these boxes, made higher."""
        size = self.half + half + [0, 0, height]
        return (size - np.abs(center[:, None] - self.center)).min(axis=2).max(axis=1, initial=-np.inf)


boxes_of, data_of = cache(Boxes), cache(mujoco.MjData)


def feet_of(model, qpos):
    """Return the feet [N, 4, 3] of ants at `qpos` [N, nq]: the ends of the lowest capsules, which begin at a body."""
    data, feet = data_of(model), np.empty((len(qpos), 4, 3))
    geoms = [model.geom(f"lower_{leg}_geom").id for leg in (1, 2, 3, 4)]
    for i, each in enumerate(qpos):
        data.qpos[:] = each
        mujoco.mj_kinematics(model, data)
        feet[i] = 2 * data.geom_xpos[geoms] - data.xpos[model.geom_bodyid[geoms]]
    return feet


def block_axes(task):
    """Return the indices of the axes along which the task's block moves; empty without a block."""
    return ["xyz".index(axis) for axis in getattr(task, "block_axes", "")]


def depths(task):
    """Return the current depths in metres by name, each [N]; positive is inside."""
    model, qpos = task.sim.model, task.sim.qpos
    robot = np.column_stack([qpos[:, :2], qpos[:, 2] if task.body.num_qpos > 2 else np.full(len(qpos), 0.5)])
    boxes = {name: boxes_of(model, name) for name in ("wall", "platform")}
    found = {f"robot in {name}": each.depth(robot) for name, each in boxes.items()}
    found |= {"robot over wall": boxes["wall"].depth(robot, height=100.0), "robot under ground": -robot[:, 2]}
    feet = feet_of(model, qpos) if task.body.name == "ant" else np.empty((len(qpos), 0, 3))
    for name, each in boxes.items() if feet.size else ():
        found[f"foot in {name}"] = each.depth(feet.reshape(-1, 3)).reshape(-1, 4).max(axis=1)
    if axes := block_axes(task):
        block, half = np.tile(model.body("block").pos, (len(qpos), 1)), model.geom("block").size
        block[:, axes] += qpos[:, task.body.num_qpos :][:, :2]
        # Not to where it could leave through the bottom: the block stands on the ground.
        inside = np.minimum((half - np.abs(robot - block))[:, :2].min(axis=1), block[:, 2] + half[2] - robot[:, 2])
        found["robot in block"] = np.where(robot[:, 2] < block[:, 2] - half[2], -1.0, inside)
        found |= {f"block in {name}": each.depth(block, half) for name, each in boxes.items()}
        found["block under ground"] = half[2] - block[:, 2] if 2 in axes else np.zeros(len(qpos))
        found["foot in block"] = (half - np.abs(feet - block[:, None])).min(axis=2).max(axis=1, initial=-np.inf)
    return found


def choose_starts(task, rng):
    """Return each robot's start and the direction of its obstacle, each [N, 2].

    A third of them aim at a corner or edge, the others at a point of a face. All start on free ground within the walls.
    """
    model, clearance = task.sim.model, CLEARANCE_M[task.body.name]
    walls, platforms = Boxes(model, "wall"), Boxes(model, "platform")
    centers, halves = walls.center[:, :2], walls.half[:, :2]
    low, high = (centers - halves).min(axis=0), (centers + halves).max(axis=0)
    if block_axes(task):
        centers = np.vstack([centers, model.body("block").pos[:2]])
        halves = np.vstack([halves, model.geom("block").size[:2]])
    chosen = []
    while len(chosen) < task.num_episodes:
        which, shift = rng.integers(len(centers)), rng.uniform(-1, 1, 2)
        shift[rng.integers(2)] = rng.choice([-1, 1])
        if rng.random() < 1 / 3:
            shift = np.sign(shift)
        angle = rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(angle), np.sin(angle)])
        start = centers[which] + shift * halves[which] - direction * rng.uniform(clearance, clearance + 0.5)
        is_clear = np.linalg.norm(np.maximum(np.abs(start - centers) - halves, 0), axis=1).min() >= clearance
        has_ground = not len(platforms.center) or platforms.depth(np.array([[*start, 0.0]]), height=100.0)[0] > 0
        if is_clear and has_ground and (start > low).all() and (start < high).all():
            chosen.append((start, direction))
    return np.array(chosen).transpose(1, 0, 2)


def crash(name, num_episodes, steps, seed, *, change=id, **options):
    """Make robots of environment `name` hit the obstacles of their world; `change` is called with the model before.

    They first act towards their obstacle, then at random, with each action held for some steps; at the end they rest
    for a second. Return the largest depths [N] by name, the last ones, and whether each simulation diverged [N].
    """

    def make_simulator(model, num_sims):
        change(model)
        return CpuSimulator(model, num_sims)

    def draw_action():
        return rng.choice([-1.0, 1.0], (num_episodes, task.action_size)) * task.control_limit

    task = make_task(name, num_episodes, find_environment(name).task.Options(**options), make_simulator)
    ids, rng = np.arange(num_episodes), np.random.default_rng(seed)
    task.reset(ids, ids)
    task.sim.qpos[:, :2], direction = choose_starts(task, rng)
    task.sim.qvel[:, :2] = direction * rng.uniform(4.0, 10.0, num_episodes)[:, None]
    if task.body.quaternion is not None:  # with any heading
        half_yaw = rng.uniform(-np.pi, np.pi, num_episodes) / 2
        task.sim.qpos[:, 3:7] = np.column_stack([np.cos(half_yaw), 0 * half_yaw, 0 * half_yaw, np.sin(half_yaw)])
    greatest, action = depths(task), draw_action()
    if task.body.name == "point":
        action = np.where(direction > 0, 1.0, -1.0) * task.control_limit
    for step in range(steps + 10):
        if step >= 4:
            action = np.where(rng.random((num_episodes, 1)) < 0.2, draw_action(), action)
        task.sim.ctrl[:] = action if step < steps else 0
        for _ in range(FRAME_SKIP):  # what Task.step does, seen from near
            task.sim.step(ids, 1)
            for each, depth in depths(task).items():
                greatest[each] = np.maximum(greatest[each], depth)
    return SimpleNamespace(greatest=greatest, last=depths(task), has_diverged=task.diverged.copy())


def assert_nothing_passes(crashes):
    pairs = [each for each in crashes.greatest if each.endswith((" in wall", " in block"))]
    touches = [crashes.greatest[each] > -TOUCH_M[each[:5].strip()] for each in pairs if not each.startswith("block")]
    assert np.any(touches, axis=0).mean() >= 0.9
    assert not crashes.has_diverged.any()
    for each, depth in crashes.greatest.items():
        assert depth.max() <= ALLOWED_M[each], f"{each}: {depth.max():.2f} m, episode {depth.argmax()}"
    for each in ALLOWED_AT_REST_M.keys() & crashes.last.keys():  # whoever hit it hard was pushed out again
        assert crashes.last[each].max() <= ALLOWED_AT_REST_M[each], each


def is_everyday(name, spec, integrator):
    """Return whether the fast tests try a world with an integrator: with its own one, and Push with both."""
    return integrator == ("euler" if spec == "shes" else "rk4") or (name.endswith("-push") and integrator == "rk4")


@pytest.mark.parametrize(
    ("name", "spec", "integrator"),
    [
        pytest.param(*world, integrator, marks=() if is_everyday(*world, integrator) else pytest.mark.extras)
        for world in WORLDS
        for integrator in INTEGRATORS
    ],
)
def test_nothing_passes_through_anything(name, spec, integrator):
    assert_nothing_passes(crash(name, 20, 15, seed=0, integrator=integrator, spec=spec))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("name", "spec"), WORLDS)
def test_nothing_passes_in_a_thousand_episodes(name, spec, integrator):
    assert_nothing_passes(crash(name, 1000, 60, seed=1, integrator=integrator, spec=spec))


def test_the_feet_are_measured_where_the_legs_end():
    model = make_task("ant-push", 1).sim.model
    feet = [[0.8, 0.8, 0.75], [-0.8, 0.8, 0.75], [-0.8, -0.8, 0.75], [0.8, -0.8, 0.75]]
    np.testing.assert_allclose(feet_of(model, model.qpos0[None])[0], feet)


@pytest.mark.parametrize(
    ("name", "prefix"),
    [("point-maze", "wall"), ("ant-maze", "wall"), ("ant-push", "block"), ("point-fall", "platform")],
)
def test_the_measurement_sees_what_passes_through(name, prefix):
    def make_intangible(model):
        for i in range(model.ngeom):
            if model.geom(i).name.startswith(prefix):
                model.geom_contype[i] = model.geom_conaffinity[i] = 0

    greatest = crash(name, 20, 15, seed=0, change=make_intangible).greatest
    assert any(depth.max() > 2 * ALLOWED_M[each] for each, depth in greatest.items())
