"""Robots do not pass through walls, platforms or the block, and the block does not enter walls or platforms.

Robots start close to a wall, the block, a corner or an edge, move towards it at up to 10 units per second and act at
the limit. The penetration is measured after every physics step by geometry alone, independently of MuJoCo's contacts:
all boxes are axis-aligned, so the depth of a point or box in another is a subtraction. The ant is represented by its
torso's centre and its feet, which reach furthest. (At 11 m/s a robot cannot cross a box of 8 m within 0.02 s.)
"""

from dataclasses import dataclass
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from shes.envs.named_environments import ENVIRONMENTS, find_environment, make_task
from shes.envs.tasks.task import FRAME_SKIP
from shes.envs.worlds import INTEGRATORS
from shes.sim.cpu import CpuSimulator

WORLDS = [(name, "shes") for name in ENVIRONMENTS if not name.endswith("-flagrun")]  # which has Gather's
WORLDS += [("point-gather", "hiro"), ("ant-gather", "hiro")]  # the only ones with other walls

START_SPEED_M_S = (4.0, 10.0)
CLEARANCE_M = {"point": 0.3, "ant": 0.95}
"""How far from walls and block the robot's centre starts at least: an ant's feet are 0.9 m ahead of it."""
RUN_UP_M = 0.5
"""How much further off it may start."""

ALLOWED_M = {
    # The robot's centre: of the point's sphere or the ant's torso, another sphere of 0.25 m. None may be over a wall.
    "robot in wall": 0.0,
    "robot over wall": 0.0,
    "robot in platform": 0.0,
    "robot under ground": 0.0,
    # Contacts with a block of 0.2 g are soft: a point that pushes with its 6 N goes on with its surface 0.2 m in it.
    # One that hits it when a wall is behind it gets 0.6 m in, its centre 0.35 m; it is pushed out again.
    "robot in block": 0.5,
    # 0.25 m at most in a thousand episodes of any task and integrator.
    "block in wall": 0.4,
    "block in platform": 0.4,
    "block under ground": 0.4,
    # 0.28 m at most in a thousand episodes. A foot that is never deeper never is beyond the wall's centre, at 4 m.
    "foot in wall": 0.4,
    "foot in platform": 0.4,
    # 0.54 m at most in a thousand episodes, of the 4 m to the block's centre plane.
    "foot in block": 0.8,
}
"""How deep they may be in each other at most."""
ALLOWED_AT_REST_M = {"robot in block": 0.0, "foot in block": 0.1, "foot in wall": 0.0, "foot in platform": 0.0}
"""The same after a second without a control; an ant may lean against the block (its feet: 0.04 m in a thousand)."""


@dataclass
class Boxes:
    """Axis-aligned boxes: centres and half sizes [B, 3]."""

    center: np.ndarray
    half: np.ndarray

    def depth(self, center, half=0.0):
        """Return the largest depth [N] of the points or boxes at `center` [N, 3] in these boxes."""
        return (self.half + half - np.abs(center[:, None] - self.center)).min(axis=2).max(axis=1)

    def up_to_the_sky(self):
        """Return these boxes extended upwards."""
        return Boxes(self.center, self.half + np.array([0.0, 0.0, 100.0]))


def find_boxes(model, prefix):
    """Return the boxes whose name begins with this."""
    found = [model.geom(i) for i in range(model.ngeom) if model.geom(i).name.startswith(prefix)]
    boxes = np.array([[geom.pos, geom.size] for geom in found]).reshape(-1, 2, 3)
    return Boxes(boxes[:, 0], boxes[:, 1])


class Legs:
    """Finds the ant's feet: the centres of the spheres, of radius 0.08 m, at the ends of its capsules."""

    def __init__(self, model):
        self.model, self.data = model, mujoco.MjData(model)
        self.geoms = [model.geom(f"lower_{leg}_geom").id for leg in (1, 2, 3, 4)]
        self.bodies = model.geom_bodyid[self.geoms]

    def find_feet(self, qpos):
        """Return the feet [N, 4, 3] of ants at `qpos` [N, nq]."""
        feet = np.empty((len(qpos), 4, 3))
        for i, each in enumerate(qpos):
            self.data.qpos[:] = each
            mujoco.mj_kinematics(self.model, self.data)
            feet[i] = 2 * self.data.geom_xpos[self.geoms] - self.data.xpos[self.bodies]  # a capsule begins at its body
        return feet


def block_axes(task):
    """Return the indices of the axes along which the task's block moves; empty without a block."""
    return ["xyz".index(axis) for axis in getattr(task, "block_axes", "")]


def depths(task, legs=None):
    """Return the current depths in metres by name, each [N]; positive is inside. `legs` measures the feet, too."""
    model, qpos = task.sim.model, task.sim.qpos
    robot = np.column_stack([qpos[:, :2], qpos[:, 2] if task.body.num_qpos > 2 else np.full(len(qpos), 0.5)])
    walls, platforms = find_boxes(model, "wall"), find_boxes(model, "platform")
    found = {"robot in wall": walls.depth(robot), "robot over wall": walls.up_to_the_sky().depth(robot)}
    found["robot under ground"] = -robot[:, 2]
    feet = np.empty((len(qpos), 0, 3)) if legs is None else legs.find_feet(qpos)
    boxes = {"wall": walls} | ({"platform": platforms} if len(platforms.center) else {})
    if platforms := boxes.get("platform"):
        found["robot in platform"] = platforms.depth(robot)
    for name in boxes if legs else ():
        found[f"foot in {name}"] = boxes[name].depth(feet.reshape(-1, 3)).reshape(-1, 4).max(axis=1)
    if axes := block_axes(task):
        block, half = np.tile(model.body("block").pos, (len(qpos), 1)), model.geom("block").size
        block[:, axes] += qpos[:, task.body.num_qpos :][:, :2]
        # Not to where it could leave through the bottom: the block stands on the ground.
        inside = np.minimum((half - np.abs(robot - block))[:, :2].min(axis=1), block[:, 2] + half[2] - robot[:, 2])
        found["robot in block"] = np.where(robot[:, 2] < block[:, 2] - half[2], -1.0, inside)
        found |= {f"block in {name}": boxes[name].depth(block, half) for name in boxes}
        if platforms:
            found["block under ground"] = half[2] - block[:, 2]
        if legs:
            found["foot in block"] = (half - np.abs(feet - block[:, None])).min(axis=2).max(axis=1)
    return found


def choose_starts(task, rng):
    """Return each robot's start and the direction of its obstacle, each [N, 2].

    A third of them aim at a corner or edge, the others at a point of a face. All start on free ground within the outer
    walls.
    """
    model = task.sim.model
    walls = find_boxes(model, "wall")
    centers, halves = walls.center[:, :2], walls.half[:, :2]
    low, high = (centers - halves).min(axis=0), (centers + halves).max(axis=0)
    if block_axes(task):
        centers = np.vstack([centers, model.body("block").pos[:2]])
        halves = np.vstack([halves, model.geom("block").size[:2]])
    clearance = CLEARANCE_M[task.body.name]
    chosen = []
    while len(chosen) < task.num_episodes:
        which = rng.integers(len(centers))
        shift = rng.uniform(-1, 1, 2)
        axis = rng.integers(2)
        shift[axis] = rng.choice([-1, 1])
        if rng.random() < 1 / 3:
            shift = np.sign(shift)
        aim = centers[which] + shift * halves[which]
        angle = rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(angle), np.sin(angle)])
        start = aim - direction * rng.uniform(clearance, clearance + RUN_UP_M)
        outside = np.maximum(np.abs(start - centers) - halves, 0)
        is_clear = np.linalg.norm(outside, axis=1).min() >= clearance
        if is_clear and (start > low).all() and (start < high).all() and is_on_ground(task, start):
            chosen.append((start, direction))
    return np.array(chosen).transpose(1, 0, 2)


def is_on_ground(task, place):
    """Return whether there is ground at the robot's height at (x, y) `place`."""
    platforms = find_boxes(task.sim.model, "platform")
    return not len(platforms.center) or platforms.up_to_the_sky().depth(np.array([[*place, 0.0]]))[0] > 0


def crash(name, num_episodes, steps, seed, *, change=None, **options):
    """Make robots of environment `name` hit the obstacles of their world.

    They first act towards their obstacle, then at random, with each action held for some steps; at the end they rest
    for a second. `change` is called with the model beforehand.

    Returns the largest depths [N] by name, the final ones, whether each robot touched an obstacle [N] and whether its
    simulation diverged [N].
    """

    def make_simulator(model, num_sims):
        if change is not None:
            change(model)
        return CpuSimulator(model, num_sims)

    def draw_action():
        return rng.choice([-1.0, 1.0], (num_episodes, task.action_size)) * task.control_limit

    task = make_task(name, num_episodes, find_environment(name).options(**options), make_simulator)
    ids, rng = np.arange(num_episodes), np.random.default_rng(seed)
    task.reset(ids, ids)
    direction = launch(task, rng)
    legs = Legs(task.sim.model) if task.body.name == "ant" else None
    greatest, touch = depths(task, legs), Touch(task)
    action = draw_action()
    if task.body.name == "point":
        action = np.where(direction > 0, 1.0, -1.0) * task.control_limit
    for step in range(steps + 10):
        if step >= 4:
            changes = rng.random(num_episodes) < 0.2
            action = np.where(changes[:, None], draw_action(), action)
        task.sim.ctrl[:] = action if step < steps else 0
        for _ in range(FRAME_SKIP):  # what Task.step does, seen from near
            task.sim.step(ids, 1)
            for each, depth in depths(task, legs).items():
                greatest[each] = np.maximum(greatest[each], depth)
            touch.look()
    return SimpleNamespace(
        greatest=greatest, last=depths(task, legs), has_touched=touch.has_touched, has_diverged=task.diverged.copy()
    )


def launch(task, rng):
    """Place every robot near an obstacle, with any heading and a velocity towards it; return the direction [N, 2]."""
    start, direction = choose_starts(task, rng)
    task.sim.qpos[:, :2] = start
    task.sim.qvel[:, :2] = direction * rng.uniform(*START_SPEED_M_S, len(start))[:, None]
    if task.body.quaternion is not None:
        half_yaw = rng.uniform(-np.pi, np.pi, len(start)) / 2
        task.sim.qpos[:, 3:7] = np.column_stack([np.cos(half_yaw), 0 * half_yaw, 0 * half_yaw, np.sin(half_yaw)])
    return direction


class Touch:
    """Records which robots have touched a wall or the block, from MuJoCo's contacts."""

    def __init__(self, task):
        self.task, self.model = task, task.sim.model
        self.data = mujoco.MjData(self.model)
        self.has_touched = np.zeros(task.num_episodes, dtype=bool)
        names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        self.obstacles = [i for i, name in enumerate(names) if name.startswith(("wall", "block"))]
        moving = self.model.geom_bodyid > 0
        self.robot = [i for i, name in enumerate(names) if moving[i] and name != "block"]

    def look(self):
        """Check the robots that have not touched anything yet."""
        for i in np.flatnonzero(~self.has_touched):
            self.data.qpos[:] = self.task.sim.qpos[i]
            mujoco.mj_fwdPosition(self.model, self.data)
            pairs = self.data.contact.geom
            of_both = np.isin(pairs, self.robot).any(axis=1) & np.isin(pairs, self.obstacles).any(axis=1)
            self.has_touched[i] = of_both.any()


def assert_nothing_passes(crashes):
    assert crashes.has_touched.mean() >= 0.9
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
    feet = Legs(model).find_feet(model.qpos0[None])[0]
    np.testing.assert_allclose(feet, [[0.8, 0.8, 0.75], [-0.8, 0.8, 0.75], [-0.8, -0.8, 0.75], [0.8, -0.8, 0.75]])


@pytest.mark.parametrize(
    ("name", "prefix"),
    [(f"{body}-{task}", box) for body in ("point", "ant") for task, box in (("maze", "wall"), ("push", "block"))]
    + [("point-fall", "platform"), ("ant-fall", "block")],
)
def test_the_measurement_sees_what_passes_through(name, prefix):
    def make_intangible(model):
        for i in range(model.ngeom):
            if model.geom(i).name.startswith(prefix):
                model.geom_contype[i] = model.geom_conaffinity[i] = 0

    greatest = crash(name, 20, 15, seed=0, change=make_intangible).greatest
    assert any(depth.max() > 2 * ALLOWED_M[each] for each, depth in greatest.items())
