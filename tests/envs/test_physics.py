"""Robots do not pass through walls, platforms or the block, and the block does not enter walls or platforms.

Robots start close to a wall or the block, move towards it at up to 10 m/s and act at the limit. The penetration is
measured after every physics step by geometry alone, independently of MuJoCo's contacts: all boxes are axis-aligned. The
ant is represented by its torso's centre and its feet, which reach furthest. (At 11 m/s a robot cannot cross a box of
8 m within 0.02 s.)
"""

import mujoco
import numpy as np
import pytest

from shes.envs.worlds import INTEGRATORS
from tests.contracts.variants import VARIANTS
from tests.envs.episodes import make_task

WORLDS = [tuple(each) for each in VARIANTS if each.spec == "shes" or each.name.endswith(("-gather", "-push"))]
WORLDS = [each for each in WORLDS if not each[0].endswith("-flagrun")]  # which has Gather's
CLEARANCE_M = {"point": 0.3, "ant": 0.95}
"""How far from walls and block the robot's centre starts at least: an ant's feet are 0.9 m ahead of it."""
TOUCH_M = {"robot": 0.27, "foot": 0.1}
"""Radius of the point or of an ant's foot, and the contact margin: nearer than this it touches."""
ALLOWED_M = {
    # The robot's centre: of the point's sphere or the ant's torso, another sphere of 0.25 m.
    **dict.fromkeys(("robot in wall", "robot in platform", "robot under ground"), 0.0),
    # A block of 0.2 g is soft: a point that hits it when a wall is behind it gets its centre 0.35 m in.
    "robot in block": 0.5,
    # 0.25 m at most in a thousand episodes of any task and integrator.
    **dict.fromkeys(("block in wall", "block in platform", "block under ground"), 0.4),
    # 0.28 m at most in a thousand episodes; in the block 0.54 m, of the 4 m to its centre plane.
    **dict.fromkeys(("foot in wall", "foot in platform"), 0.4),
    "foot in block": 0.8,
}
"""How deep they may be in each other at most."""


def boxes_of(model, prefix):
    """Return centres and half sizes [B, 3] of the geoms whose name begins with `prefix`; walls are infinitely high."""
    found = [each for each in map(model.geom, range(model.ngeom)) if each.name.startswith(prefix)]
    center = np.array([model.body_pos[each.bodyid[0]] + each.pos for each in found]).reshape(-1, 3)
    half = np.array([each.size for each in found]).reshape(-1, 3)
    return center, half + np.array([0, 0, 100.0 * (prefix == "wall")])


def depth_in(boxes, center, half=0.0):
    """Return the largest depth [N] of points or boxes at `center` [N, 3] in these boxes."""
    return (boxes[1] + half - np.abs(center[:, None] - boxes[0])).min(axis=2).max(axis=1, initial=-np.inf)


def feet_of(model, qpos):
    """Return the feet [N, 4, 3] of ants at `qpos` [N, nq]: the ends of the lowest capsules, which begin at a body."""
    data, feet = mujoco.MjData(model), np.empty((len(qpos), 4, 3))
    geoms = [model.geom(f"lower_{leg}_geom").id for leg in (1, 2, 3, 4)]
    for i, each in enumerate(qpos):
        data.qpos[:] = each
        mujoco.mj_kinematics(model, data)
        feet[i] = 2 * data.geom_xpos[geoms] - data.xpos[model.geom_bodyid[geoms]]
    return feet


def depths(task, boxes):
    """Return the current depths in metres by name, each [N]; positive is inside."""
    model, qpos = task.sim.model, task.sim.qpos
    n, axes = len(qpos), ["xyz".index(axis) for axis in getattr(task, "block_axes", "")]
    robot = np.column_stack([qpos[:, :2], qpos[:, 2] if task.body.num_qpos > 2 else np.full(n, 0.5)])
    feet = feet_of(model, qpos) if task.body.name == "ant" else np.empty((n, 0, 3))
    found = {"robot under ground": -robot[:, 2]}
    for name, each in boxes.items():
        found[f"robot in {name}"] = depth_in(each, robot)
        if feet.size:
            found[f"foot in {name}"] = depth_in(each, feet.reshape(-1, 3)).reshape(n, 4).max(axis=1)
    if axes:
        block, half = np.tile(model.body("block").pos, (n, 1)), model.geom("block").size
        block[:, axes] += qpos[:, task.body.num_qpos :][:, :2]
        # Not to where it could leave through the bottom: the block stands on the ground.
        inside = np.minimum((half - np.abs(robot - block))[:, :2].min(axis=1), block[:, 2] + half[2] - robot[:, 2])
        found["robot in block"] = np.where(robot[:, 2] < block[:, 2] - half[2], -1.0, inside)
        found |= {f"block in {name}": depth_in(each, block, half) for name, each in boxes.items()}
        found["block under ground"] = half[2] - block[:, 2] if 2 in axes else np.zeros(n)
        found["foot in block"] = (half - np.abs(feet - block[:, None])).min(axis=2).max(axis=1, initial=-np.inf)
    return found


def choose_starts(task, rng):
    """Return each robot's start, on free ground, and the direction of its nearest obstacle, each [N, 2]."""
    model, clearance = task.sim.model, CLEARANCE_M[task.body.name]
    walls, block, platforms = (boxes_of(model, prefix) for prefix in ("wall", "block", "platform"))
    centers, halves = (np.vstack(each)[:, :2] for each in zip(walls, block, strict=True))
    places = rng.uniform((centers - halves).min(axis=0), (centers + halves).max(axis=0), (40_000, 2))
    offset = centers - places[:, None]
    gaps = np.sign(offset) * np.maximum(np.abs(offset) - halves, 0)  # to the nearest point of each obstacle
    nearest = np.linalg.norm(gaps, axis=2).argmin(axis=1)
    gaps = gaps[range(len(places)), nearest]
    distance = np.linalg.norm(gaps, axis=1)
    is_good = (distance > clearance) & (distance < clearance + 0.5)
    if len(platforms[0]):
        is_good &= depth_in(platforms, np.column_stack([places, np.full(len(places), 2.0)])) > 0
    chosen = np.flatnonzero(is_good)[: task.num_episodes]
    return places[chosen], gaps[chosen] / distance[chosen, None]


def crash(name, num_episodes, steps, seed, **options):
    """Make robots of environment `name` hit the obstacles of their world; return the largest depths [N] by name.

    They first act towards their obstacle, then at random, with each action held for some steps.
    """

    def draw_action():
        return rng.choice([-1.0, 1.0], (num_episodes, task.action_size)) * task.control_limit

    task = make_task(name, num_episodes, **options)
    ids, rng = np.arange(num_episodes), np.random.default_rng(seed)
    task.reset(ids, ids)
    task.sim.qpos[:, :2], direction = choose_starts(task, rng)
    task.sim.qvel[:, :2] = direction * rng.uniform(4.0, 10.0, num_episodes)[:, None]
    if task.body.quaternion is not None:  # with any heading
        half_yaw = rng.uniform(-np.pi, np.pi, num_episodes) / 2
        task.sim.qpos[:, 3:7] = np.column_stack([np.cos(half_yaw), 0 * half_yaw, 0 * half_yaw, np.sin(half_yaw)])
    boxes = {name: boxes_of(task.sim.model, name) for name in ("wall", "platform")}
    greatest, action = depths(task, boxes), draw_action()
    if task.body.name == "point":
        action = np.where(direction > 0, 1.0, -1.0) * task.control_limit
    for step in range(steps):
        if step >= 4:
            action = np.where(rng.random((num_episodes, 1)) < 0.2, draw_action(), action)
        task.sim.ctrl[:] = action
        for _ in range(task.body.frame_skip):  # what Task.step does, seen from near
            task.sim.step(ids, 1)
            for each, depth in depths(task, boxes).items():
                greatest[each] = np.maximum(greatest[each], depth)
    assert not task.diverged.any()
    return greatest


def assert_nothing_passes(greatest):
    pairs = [each for each in greatest if each.endswith((" in wall", " in block")) and not each.startswith("block")]
    touches = [greatest[each] > -TOUCH_M[each[:5].strip()] for each in pairs]
    assert np.any(touches, axis=0).mean() >= 0.9
    for each, depth in greatest.items():
        assert depth.max() <= ALLOWED_M[each], f"{each}: {depth.max():.2f} m, episode {depth.argmax()}"


@pytest.mark.parametrize(("name", "spec"), WORLDS)
def test_nothing_passes_through_anything(name, spec):
    assert_nothing_passes(crash(name, 16, 12, seed=0, spec=spec))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("name", "spec"), WORLDS)
def test_nothing_passes_in_a_thousand_episodes(name, spec, integrator):
    assert_nothing_passes(crash(name, 1000, 60, seed=1, integrator=integrator, spec=spec))
