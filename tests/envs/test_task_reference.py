"""Every task against the plain reference, which steps its own `MjData` of the same model and draws from the same seeds.

The task steps all episodes at once; the reference handles one episode and one number at a time. They are bit-identical,
except for Flagrun's three features of the goal.
"""

from itertools import count

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shes.envs.bodies.ant import Ant
from shes.envs.worlds import INTEGRATORS
from tests.contracts import variants
from tests.envs.episodes import make_task
from tests.envs.reference_tasks import REFERENCES, yaw
from tests.envs.reference_worlds import world

VARIANTS = [pytest.param(*each, id="-".join(each)) for each in variants.VARIANTS]


def over(*endings):
    """Return a parametrization over the variants of the tasks with these names; of all without one."""
    chosen = [each for each in VARIANTS if not endings or each.values[0].endswith(endings)]
    return pytest.mark.parametrize(("name", "spec"), chosen)


def draw_actions(rng, num_episodes, size):
    """Yield actions of -1, 0 or 1 that each episode keeps for about ten steps, so that it travels."""
    actions = rng.integers(-1, 2, (num_episodes, size)).astype(float)
    while True:
        yield actions
        changes = rng.random(num_episodes) < 0.1
        actions = np.where(changes[:, None], rng.integers(-1, 2, actions.shape), actions)


def assert_same(task, ids, references, step):
    """Compare every array of episodes `ids`."""
    seen, expected = task.observe()[ids], np.array([references[i].observation() for i in ids])
    tolerated = 3 if task.name == "flagrun" else 0  # sine and cosine; the distance is times 0.001 there, / 1000 here
    assert_allclose(seen[:, :tolerated], expected[:, :tolerated], rtol=0, atol=1e-12, err_msg=f"step {step}")
    assert_array_equal(seen[:, tolerated:], expected[:, tolerated:], err_msg=f"observation at step {step}")
    for shown in ("reward", "running_return", "score", "success", "distance", "diverged"):
        wanted = [getattr(references[i], shown) for i in ids]
        assert_array_equal(getattr(task, shown)[ids], wanted, err_msg=f"{shown} at step {step}")


def compare(task, references, steps, arrange, seed=12):
    """Play `steps` in both and compare every array after each; return how often an episode terminated.

    An episode that has terminated, or has lasted long enough, rests for some steps while the others continue, and is
    then reset with a new seed, so that the episodes of the batch are soon at different steps.
    """
    n, rng, seeds, num_ends = task.num_episodes, np.random.default_rng(seed), count(), 0

    def reset(which):
        drawn = [next(seeds) for _ in which]
        task.reset(which, drawn)
        for i, drawn_seed in zip(which, drawn, strict=True):
            references[i].reset(drawn_seed)
        assert_same(task, which, references, "reset")

    reset(np.arange(n))
    arrange(task, rng)
    for i, reference in enumerate(references):
        reference.data.qpos[:], reference.data.qvel[:] = task.sim.qpos[i], task.sim.qvel[i]
        if task.name == "gather":
            reference.food, reference.poison = (list(map(tuple, each)) for each in task.objects[i].tolist())
    limits, is_resting = rng.integers(steps // 2, 2 * steps, n), np.zeros(n, dtype=bool)
    for step, action in zip(range(steps), draw_actions(rng, n, task.action_size), strict=False):
        begins = is_resting & (rng.random(n) < 0.3)
        if begins.any():
            reset(np.flatnonzero(begins))
            is_resting &= ~begins
        moving = np.flatnonzero(~is_resting)
        controls = action * task.control_limit
        task.step(moving, controls)
        ends = np.array([references[i].step(controls[i]) for i in moving], dtype=bool)
        assert_array_equal((task.terminated | task.diverged)[moving], ends, err_msg=f"end at step {step}")
        if len(moving):
            assert_same(task, moving, references, step)
        num_ends += ends.sum()
        is_resting[moving] = ends | (task.time[moving] >= limits[moving])
    assert not task.diverged.any()
    return num_ends


def launch(task, rng):
    """Place every robot in its world at up to 8 m/s: some fly, some hit walls, block or chasm at once."""
    n = task.num_episodes
    task.sim.qpos[:, :2] += rng.uniform(-2, 2, (n, 2))
    task.sim.qvel[:, :2] = rng.uniform(-8, 8, (n, 2))
    if task.body.quaternion is not None:
        task.sim.qvel[:, 2] = rng.uniform(0, 3, n)
        task.sim.qvel[:, 5] = rng.normal(0, 3, n)


def launch_among_objects(task, rng):
    """Launch every ant, some upwards, and place its objects around the path ahead."""
    launch(task, rng)
    velocity = task.sim.qvel[:, :2]
    unit = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    along = rng.uniform(0.5, 2.5, (task.num_episodes, 2, 8, 1))
    task.objects[:] = along * unit[:, None, None, :] + rng.normal(0, 0.5, task.objects.shape)


def play(name, num_episodes, steps, spec, reference=None, arrange=launch, **options):
    """Compare environment `name` with these options; `reference` are those of its reference. Return task and ends."""
    task = make_task(name, num_episodes, spec=spec, **options)
    make = REFERENCES[task.name]
    references = [make(task.body.name, spec, task.sim.model, **reference or {}) for _ in range(num_episodes)]
    return task, compare(task, references, steps, arrange)


@over()
def test_a_task_equals_its_reference(name, spec):
    task, ends = play(name, 6, 30, spec)
    if name in ("ant-flagrun", "ant-gather"):
        assert ends > 0  # an ant that is thrown falls
    hidden = len(task.own_target) if spec == "hiro" and hasattr(task, "own_target") else 0  # the controller's alone
    assert_array_equal(task.primitive_view, np.arange(task.observation_size - hidden))


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_gather_equals_its_reference_among_objects(spec):
    task, ends = play("ant-gather", 10, 20, spec, arrange=launch_among_objects)
    assert 3 < ends < 30
    assert min(task.counts["food"].sum(), task.counts["poison"].sum()) > 5


@pytest.mark.slow
@pytest.mark.timeout(600)
@over()
def test_a_task_equals_its_reference_over_long_episodes(name, spec):
    play(name, 12, 500, spec)


@over("-maze", "-push", "-fall", "-flagrun")
def test_success_begins_just_below_its_radius(name, spec):
    task = make_task(name, 3, spec=spec)
    radius, aims = (1.0, task.goal) if task.name == "flagrun" else (5.0, task.target)
    task.sim.qpos[:, 0] = 0
    aims[:] = task.sim.qpos[:, : aims.shape[1]]
    aims[:, 0] = [np.nextafter(radius, 0), radius, -radius]
    task.step(np.array([], dtype=np.int64), np.zeros((3, task.action_size)))  # moves none, and looks at all
    assert_array_equal(task.distance, np.abs(aims[:, 0]))
    assert_array_equal(task.success, [True, False, False])
    if task.name != "flagrun":
        assert_array_equal(task.score, [1, 0, 0])


@pytest.mark.parametrize("spec", ["shes", "hiro"])
@pytest.mark.parametrize(
    ("name", "options", "reference"),
    [
        *(
            (name, {"reset_noise": noise}, {"reset_noise": noise})
            for name in ("ant-gather", "point-fall", "point-maze")
            for noise in (0.0, 0.5)
        ),
        *(
            (name, options, {"target": target, "is_fixed": True})
            for name, own, target in (
                ("point-maze", (0.0, 16.0), (8.0, 3.5)),
                ("point-push", (0.0, 19.0), (-7.5, 1.0)),
                ("point-fall", (0.0, 27.0, 4.5), (1.0, 9.0, 6.0)),
            )
            for options, target in (
                ({"evaluation": True}, own),
                ({"target": target}, target),
                ({"evaluation": True, "target": target}, target),
            )
        ),
        *(("point-flagrun", {"controller_interval": interval}, {"interval": interval}) for interval in (1, 3)),
    ],
)
def test_with_options_a_task_equals_its_reference(name, options, reference, spec):
    play(name, 3, 12, spec, reference, **options)


def test_yaw_equals_the_reference_for_any_rotation():
    qpos = np.random.default_rng(0).normal(size=(200, 15))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    assert_allclose(Ant().heading(qpos), [yaw(each[3:7]) for each in qpos], atol=1e-9)


def test_the_ant_has_fallen_outside_20_cm_to_1_m():
    heights = [-1, 0.19, np.nextafter(0.2, 0), 0.2, 0.75, 1.0, np.nextafter(1.0, 2), 1.1, np.nan]
    qpos = np.zeros((len(heights), 15))
    qpos[:, 2] = heights
    assert_array_equal(Ant().fallen(qpos), [True, True, True, False, False, False, True, True, True])


def model_differences(model, other):
    """Return what differs in all fields that the physics reads. Geoms are matched by body, type and position."""

    def physics(model):
        keys = np.column_stack([model.geom_bodyid, model.geom_type, model.geom_pos, model.geom_size]).round(9) + 0.0
        order = sorted(range(model.ngeom), key=lambda geom: tuple(keys[geom]))
        sizes = ("nq", "nv", "nu", "nbody", "njnt", "ngeom", "npair", "nexclude", "neq", "ntendon")
        found = {name: getattr(model, name) for name in sizes}
        found |= {f"opt.{name}": getattr(model.opt, name) for name in dir(model.opt) if not name.startswith("_")}
        for name in dir(model):
            if name.startswith(("body_", "jnt_", "dof_", "geom_", "actuator_", "qpos")):
                values = getattr(model, name)
                found[name] = values[order] if name.startswith("geom_") else values
        return {name: value for name, value in found.items() if isinstance(value, int | float | np.ndarray)}

    ours, theirs = physics(model), physics(other)
    without_meaning = {"geom_rgba", "body_bvhadr", "body_bvhnum"}  # colours; bounding volumes follow from the geoms
    return [name for name in ours.keys() - without_meaning if not np.array_equal(ours[name], theirs[name])]


@over()
def test_a_world_equals_the_references(name, spec):
    body, task = name.split("-")
    assert model_differences(make_task(name, 1, spec=spec).sim.model, world(task, body, spec)) == []


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_an_option_sets_the_integrator(integrator):
    options = make_task("point-gather", 1, integrator=integrator).sim.model.opt
    assert options.integrator == getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
