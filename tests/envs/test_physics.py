"""Robots do not pass through walls, platforms or the block, and the block does not enter walls or platforms.

Robots start before the first obstacle in a random direction, at up to 10 m/s, and act at the limit. The penetration is
measured after every physics step by geometry alone, independently of MuJoCo's contacts: all boxes are axis-aligned, and
a robot is its centre. (At 11 m/s a robot cannot cross a box of 8 m within 0.02 s.)
"""

import numpy as np
import pytest

from shes.envs.worlds import INTEGRATORS
from tests.contracts.variants import VARIANTS
from tests.envs.episodes import make_task

WORLDS = [tuple(each) for each in VARIANTS if each.spec == "shes" or each.name.endswith(("-gather", "-push"))]
WORLDS = [each for each in WORLDS if not each[0].endswith("-flagrun")]  # which has Gather's
ALLOWED_M = {
    **dict.fromkeys(("robot in wall", "robot in platform", "robot under ground"), 0.0),
    # A block of 0.2 g is soft: a point that hits it when a wall is behind it gets its centre 0.35 m in.
    "robot in block": 0.5,
    # 0.25 m at most in a thousand episodes of any task and integrator.
    **dict.fromkeys(("block in wall", "block in platform", "block under ground"), 0.4),
}
"""How deep they may be in each other at most."""
CLEARANCE_M, TOUCH_M = 1.3, {"point": -0.27, "ant": -1.1}
"""Distance of a robot's centre from its obstacle at the start, and the depth at which the robot may touch it."""


def boxes_of(model, prefix):
    """Return centres and half sizes [B, 3] of the geoms with this `prefix`, infinitely high but for platforms."""
    found = [each for each in map(model.geom, range(model.ngeom)) if each.name.startswith(prefix)]
    center = np.array([model.body_pos[each.bodyid[0]] + each.pos for each in found]).reshape(-1, 3)
    half = np.array([each.size for each in found]).reshape(-1, 3)
    return center, half + np.array([0, 0, 100.0 * (prefix != "platform")])


def depth_in(boxes, center, half=0.0):
    """Return the largest depth [N] of points or boxes at `center` [N, 3] in these boxes."""
    return (boxes[1] + half - np.abs(center[:, None] - boxes[0])).min(axis=2).max(axis=1, initial=-np.inf)


def depths(task, boxes):
    """Return the current depths in metres by name, each [N]; positive is inside."""
    model, qpos, axes = task.sim.model, task.sim.qpos, ["xyz".index(axis) for axis in getattr(task, "block_axes", "")]
    robot = np.column_stack([qpos[:, :2], qpos[:, 2] if task.body.num_qpos > 2 else np.full(len(qpos), 0.5)])
    found = {f"robot in {name}": depth_in(each, robot) for name, each in boxes.items()}
    found["robot under ground"] = -robot[:, 2]
    if axes:
        block, half = np.tile(model.body("block").pos, (len(qpos), 1)), model.geom("block").size
        block[:, axes] += qpos[:, task.body.num_qpos :][:, :2]
        # Not to where it could leave through the bottom: the block stands on the ground.
        inside = np.minimum((half - np.abs(robot - block))[:, :2].min(axis=1), block[:, 2] + half[2] - robot[:, 2])
        found["robot in block"] = np.where(robot[:, 2] < block[:, 2] - half[2], -1.0, inside)
        found |= {f"block in {name}": depth_in(each, block, half) for name, each in boxes.items()}
        found["block under ground"] = half[2] - block[:, 2] if 2 in axes else np.zeros(len(qpos))
    return found


def crash(name, num_episodes, steps, seed, **options):
    """Throw robots of environment `name` at the obstacles of their world; each action is held for some steps."""
    task = make_task(name, num_episodes, **options)
    ids, rng = np.arange(num_episodes), np.random.default_rng(seed)
    task.reset(ids, ids)
    angle, half_yaw = rng.uniform(-np.pi, np.pi, num_episodes), rng.uniform(-np.pi, np.pi, num_episodes) / 2
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    boxes = {name: boxes_of(task.sim.model, name) for name in ("wall", "platform", "block")}
    obstacles = [np.concatenate(each) for each in zip(boxes["wall"], boxes.pop("block"), strict=True)]
    places = np.arange(0, 18, 0.1)[:, None, None] * np.column_stack([direction, 0 * angle])
    is_near = np.array([depth_in(obstacles, each) > -CLEARANCE_M for each in places])
    task.sim.qpos[:, :2] = 0.1 * is_near.argmax(axis=0)[:, None] * direction
    task.sim.qvel[:, :2] = direction * rng.uniform(4.0, 10.0, num_episodes)[:, None]
    if task.body.quaternion is not None:  # with any heading
        task.sim.qpos[:, 3:7] = np.column_stack([np.cos(half_yaw), 0 * half_yaw, 0 * half_yaw, np.sin(half_yaw)])
    greatest, action = depths(task, boxes), np.sign(np.resize(direction.T, (task.action_size, num_episodes)).T)
    for step in range(steps):
        if step >= 4:
            changes = rng.random((num_episodes, 1)) < 0.2
            action = np.where(changes, rng.choice([-1.0, 1.0], action.shape), action)
        task.sim.ctrl[:] = action * task.control_limit
        for _ in range(task.body.frame_skip):  # what Task.step does, seen from near
            task.sim.step(ids, 1)
            for each, depth in depths(task, boxes).items():
                greatest[each] = np.maximum(greatest[each], depth)
    assert not task.diverged.any()
    touched = np.max([greatest[each] for each in ("robot in wall", "robot in block") if each in greatest], axis=0)
    assert (touched > TOUCH_M[task.body.name]).mean() >= 0.7
    for each, depth in greatest.items():
        assert depth.max() <= ALLOWED_M[each], f"{each}: {depth.max():.2f} m, episode {depth.argmax()}"


@pytest.mark.parametrize(("name", "spec"), WORLDS)
def test_nothing_passes_through_anything(name, spec):
    crash(name, 16, 12, seed=0, spec=spec)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("name", "spec"), WORLDS)
def test_nothing_passes_in_a_thousand_episodes(name, spec, integrator):
    crash(name, 1000, 60, seed=1, integrator=integrator, spec=spec)
