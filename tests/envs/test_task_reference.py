"""Every task against the plain reference, which steps its own `MjData` of the same model and draws from the same seeds.

The task steps all episodes at once; the reference handles one episode and one number at a time. They are bit-identical,
except for Flagrun's three features of the goal.
"""

from itertools import count

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shes.envs.bodies.point import DAMPING, GEAR_N
from shes.envs.named_environments import find_environment, make_task
from shes.envs.tasks.task_options import TaskOptions
from shes.envs.worlds import INTEGRATORS
from tests.contracts import variants
from tests.envs import reference_tasks
from tests.envs.compare_models import model_differences

REFERENCES = {
    name: getattr(reference_tasks, f"Reference{name.title()}") for name in ("maze", "push", "fall", "flagrun", "gather")
}
VARIANTS = [pytest.param(*each, id="-".join(each)) for each in variants.VARIANTS]
FALL_LIMIT_SOLIMP = "0.995 0.995 0.01"
"""Our deviation: the falling block's limit along y is as stiff as the contacts."""


def over(*endings):
    """Return a parametrization over the variants of the tasks with these names; of all without one."""
    chosen = [each for each in VARIANTS if not endings or each.values[0].endswith(endings)]
    return pytest.mark.parametrize(("name", "spec"), chosen)


def draw_independent(rng, num_episodes, size):
    """Yield actions in [-1, 1] that are drawn for every step."""
    while True:
        yield rng.uniform(-1, 1, (num_episodes, size))


def draw_lasting(rng, num_episodes, size):
    """Yield actions of -1, 0 or 1 that each episode keeps for about ten steps, so that it travels."""
    actions = rng.integers(-1, 2, (num_episodes, size)).astype(float)
    while True:
        yield actions
        changes = rng.random(num_episodes) < 0.1
        actions = np.where(changes[:, None], rng.integers(-1, 2, actions.shape), actions)


def make_reference(task, target=None, **options):
    """Return the reference of `task`'s body, kind and specification, with its model; `target` is not its own."""
    reference = REFERENCES[task.name](task.body.name, task.options.spec, task.sim.model, **options)
    if target is not None:
        reference.fixed_target, reference.target, reference.evaluation = target, np.array(target), True
    return reference


def observe_otherwise(reference):
    """Return the observation of Push and Fall with the block if their specification hides it, else without it."""
    nq, nv = reference.num_robot
    qpos, qvel = reference.data.qpos, reference.data.qvel
    if reference.spec == "shes":
        qpos, qvel = qpos[:nq], np.clip(qvel[:nv], -10, 10)
    return np.array([*qpos, *qvel, reference.steps * 0.001, *reference.target])


def assert_same(task, ids, references, observe, step):
    """Compare every array of episodes `ids`."""
    seen = task.observe()[ids]
    expected = np.array([(observe or type(references[i]).observation)(references[i]) for i in ids])
    tolerated = 3 if task.name == "flagrun" else 0  # sine and cosine; the distance is times 0.001 there, / 1000 here
    assert_allclose(seen[:, :tolerated], expected[:, :tolerated], rtol=0, atol=1e-12, err_msg=f"step {step}")
    assert_array_equal(seen[:, tolerated:], expected[:, tolerated:], err_msg=f"observation at step {step}")
    for shown in ("reward", "running_return", "score", "success", "distance", "diverged"):
        wanted = [getattr(references[i], shown) for i in ids]
        assert_array_equal(getattr(task, shown)[ids], wanted, err_msg=f"{shown} at step {step}")
    if task.options.spec == "hiro" and hasattr(references[0], "low_level_observation") and observe is None:
        low = [references[i].low_level_observation() for i in ids]
        assert_array_equal(seen[:, task.primitive_view], low, err_msg=f"low level at step {step}")


def compare(task, references, steps, draw, *, arrange=None, observe=None, seed=12):
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
        assert_same(task, which, references, observe, "reset")

    reset(np.arange(n))
    if arrange is not None:
        arrange(task, rng)
        for i, reference in enumerate(references):
            reference.data.qpos[:], reference.data.qvel[:] = task.sim.qpos[i], task.sim.qvel[i]
            if task.name == "gather":
                reference.food, reference.poison = (list(map(tuple, each)) for each in task.objects[i].tolist())
    limits, is_resting = rng.integers(steps // 2, 2 * steps, n), np.zeros(n, dtype=bool)
    for step, action in zip(range(steps), draw(rng, n, task.action_size), strict=False):
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
            assert_same(task, moving, references, observe, step)
        num_ends += ends.sum()
        is_resting[moving] = ends | (task.time[moving] >= limits[moving])
    assert not task.diverged.any()
    return num_ends


def play(name, num_episodes, steps, draw=draw_lasting, *, arrange=None, observe=None, reference=(), **options):
    """Compare environment `name` with these options; `reference` are those of its reference."""
    task = make_task(name, num_episodes, find_environment(name).task.Options(**options))
    references = [make_reference(task, **dict(reference)) for _ in range(num_episodes)]
    return compare(task, references, steps, draw, arrange=arrange, observe=observe)


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


# Episodes.


@over()
def test_a_task_equals_its_reference(name, spec):
    play(name, 5, 30, spec=spec)


@over()
def test_a_task_equals_its_reference_at_walls_and_blocks(name, spec):
    ends = play(name, 6, 25, draw_independent, arrange=launch, spec=spec)
    if name in ("ant-flagrun", "ant-gather"):
        assert ends > 0  # an ant that is thrown falls


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_gather_equals_its_reference_among_objects(spec):
    task = make_task("ant-gather", 20, TaskOptions(spec=spec))
    references = [make_reference(task) for _ in range(20)]
    assert 3 < compare(task, references, 40, draw_lasting, arrange=launch_among_objects) < 60
    assert task.counts["food"].sum() > 10
    assert task.counts["poison"].sum() > 10


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("draw", [draw_independent, draw_lasting], ids=["independent", "lasting"])
@over()
def test_a_task_equals_its_reference_over_long_episodes(name, spec, draw):
    play(name, 12, 500, draw, arrange=launch, spec=spec)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("integrator", INTEGRATORS)
@over()
def test_a_task_equals_its_reference_with_every_integrator(name, spec, integrator):
    play(name, 8, 100, arrange=launch, spec=spec, integrator=integrator)


@over("-maze", "-push", "-fall", "-flagrun")
def test_success_begins_just_below_its_radius(name, spec):
    task = make_task(name, 3, TaskOptions(spec=spec))
    radius, aims = (1.0, task.goal) if task.name == "flagrun" else (5.0, task.target)
    task.sim.qpos[:, 0] = 0
    aims[:] = task.sim.qpos[:, : aims.shape[1]]
    aims[:, 0] = [np.nextafter(radius, 0), radius, -radius]
    task.step(np.array([], dtype=np.int64), np.zeros((3, task.action_size)))  # moves none, and looks at all
    assert_array_equal(task.distance, np.abs(aims[:, 0]))
    assert_array_equal(task.success, [True, False, False])
    if task.name != "flagrun":
        assert_array_equal(task.score, [1, 0, 0])


# Options.


@over()
def test_with_other_reset_noise_a_task_equals_its_reference(name, spec):
    for noise in (0.0, 0.5):
        play(name, 2, 4, spec=spec, reset_noise=noise, reference={"reset_noise": noise})


@pytest.mark.parametrize("spec", ["shes", "hiro"])
@pytest.mark.parametrize(
    ("name", "target"), [("point-maze", (8.0, 3.5)), ("point-push", (-7.5, 1.0)), ("point-fall", (1.0, 9.0, 6.0))]
)
def test_fixed_targets_equal_the_references(name, target, spec):
    play(name, 4, 10, spec=spec, evaluation=True, reference={"evaluation": True})
    for options in ({"target": target}, {"evaluation": True, "evaluation_target": target}):
        play(name, 4, 20, spec=spec, **options, reference={"target": target})


@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_targets_in_free_cells_equal_the_references(spec):
    play("point-maze", 40, 2, spec=spec, target_sampling="free_cells", reference={"free_cells": True})


@over("-push", "-fall")
def test_the_block_can_be_observed_or_not(name, spec):
    play(name, 3, 15, arrange=launch, spec=spec, observe_block=spec == "hiro", observe=observe_otherwise)
    play(name, 3, 10, spec=spec, observe_block=spec == "shes")  # as specified


@over("-flagrun")
@pytest.mark.parametrize("interval", [1, 3, 10])
def test_flagrun_equals_its_reference_with_any_interval(name, spec, interval):
    play(name, 4, 24, spec=spec, controller_interval=interval, reference={"interval": interval})


# Worlds.


@over()
def test_a_world_equals_the_references(name, spec):
    body, task = name.split("-")
    more = {} if (task, spec) == ("gather", "hiro") else {"merged": True}
    more |= {"limit_solimp": FALL_LIMIT_SOLIMP} if task == "fall" else {}
    cannot_act = {"opt.gravity"} if body == "point" else ()  # its slides, and those of Push's block, are horizontal
    for integrator in INTEGRATORS:
        model = make_task(name, 1, TaskOptions(spec=spec, integrator=integrator)).sim.model
        reference = REFERENCES[task](body, spec, integrator=integrator, gear=GEAR_N, damping=DAMPING, **more)
        assert model_differences(model, reference.model, but=cannot_act) == []
    own = make_task(name, 1, TaskOptions(spec=spec)).sim.model.opt.integrator
    assert own == INTEGRATORS["euler" if spec == "shes" else "rk4"]
