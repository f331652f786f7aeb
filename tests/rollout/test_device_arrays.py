"""Agents and rollouts whose arrays lie on a device: the numbers of the CPU, two waits a step, and one place for noise.

The device is a stand-in, `strict_arrays`: it refuses what CuPy refuses. Weights lie elsewhere in memory than the CPU's,
so that a matmul may round differently: numbers agree to a tolerance, counts exactly.
"""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.es.noise import NoiseTable, weighted_noise_sum
from shes.evolution.algorithm import evolve
from shes.rollout.lockstep import Rollout
from shes.rollout.worker import RolloutWorker, WorkerPlan
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from shes.sim.simulator import CpuSimulator
from tests.rollout.formula import leaves
from tests.rollout.made_up import taking
from tests.strict_arrays import DeviceSimulator, strict_xp

HORIZON = 11
SETTINGS = {"hidden": (8,), "horizon": HORIZON, "population_size": 8, "noise_table_size": 20_000}
WHOLE = {"primitive_estimate": "episode"}
UNSEARCHED = {"explore": "none"}  # goals would wander
EGOCENTRIC = {**WHOLE, "primitive_view": "egocentric"}
CHOICES = {
    "gather": ("point-gather", {}),
    "one-hot": ("point-push", {**UNSEARCHED, "controller_output": "one_hot", "minimum_goal_distance": True}),
    "unit vector": ("point-maze", {**UNSEARCHED, "goal_encoding": "unit_vector", "primitive_reward": "cosine"}),
    "vector": ("point-maze", {**UNSEARCHED, "goal_encoding": "vector", "primitive_reward": "negative_distance"}),
    "metres": ("point-fall", {**UNSEARCHED, "goal_encoding": "angle_metres", "clock_frequency": 1.5}),
    "primitive alone": ("point-flagrun", {}),
    "flat": ("point-gather", {"algorithm": "es", "clock_frequency": 1.5}),
    "one level in turns": ("point-gather", {"perturbation": "one_to_many", "statistics_fraction": 0.5}),
    "egocentric": (
        "ant-gather",
        {**EGOCENTRIC, "symmetry": "dihedral", "controller_network": "mlp", "controller_view": "egocentric",
         "controller_output": "heading_direction", "primitive_reward": "metres"},
    ),
    "equivariant": (
        "point-gather",
        {"controller_network": "equivariant", "controller_view": "sectors", "controller_output": "heading_direction"},
    ),
    "position": ("point-maze", {**UNSEARCHED, "controller_view": "position", "controller_output": "direction"}),
    "egocentric, alone": ("ant-flagrun", {**EGOCENTRIC, "symmetry": "rotation", "max_tilt": 20.0}),
    "falls that end": ("ant-maze", {**WHOLE, "max_tilt": 14.0, "fitness_shaping": "centred_rank"}),
}  # fmt: skip


def make(env, settings, **more):
    """Return the learner of these settings."""
    goals = {} if "algorithm" in settings else {"controller_interval": 4}
    return build_algorithm(make_config(env, "laptop", {**SETTINGS, **goals, **settings, **more}))


def run(name, simulator, num_lanes, xp=np, episodes=3, **changed):
    """Return the results of a generation, by number, and the waits for the device from each step to the next."""
    learner = make(*CHOICES[name], episodes_per_policy=episodes)
    settings, plan = learner.hyperparameters, learner.plan()
    draws = settings.estimates[0](learner.start(1), settings, learner.table.size, ())
    generation, waits = replace(draws.generation, **changed), []

    def make_batch(num_episodes):
        batch = plan.env.make(num_episodes, plan.training, simulator)
        observe = batch.observe
        batch.observe = lambda: (waits.append(strict_xp.waits), observe())[1]  # the first thing in a step
        return batch

    shape = generation.rows_per_lane, HORIZON, generation.members_per_lane
    rollout = Rollout(learner.design, make_batch, num_lanes, *shape)
    found = dict(rollout.run(taking(enumerate(draws.tasks)), generation, learner.table.on(xp)))
    return found, np.diff(waits)


def assert_close(mine, theirs, tolerance=1e-5):
    """Compare results, or parts of them, all of which are on the host; whole numbers exactly."""
    one, other = (dict(leaves(each)) for each in (mine, theirs))
    assert one.keys() == other.keys()
    for place, value in one.items():
        assert type(value) is type(other[place]), place
        if np.asarray(value).dtype.kind == "f":
            np.testing.assert_allclose(value, other[place], rtol=tolerance, atol=tolerance, err_msg=place)
        else:
            np.testing.assert_array_equal(value, other[place], err_msg=place)


@pytest.mark.parametrize(
    ("name", "lanes", "episodes", "changed"),
    [
        *((name, 8, 3, {}) for name in CHOICES),
        *((name, 2, 1, {}) for name in ("gather", "flat", "one level in turns")),  # members share their noise
        ("gather", 3, 3, {}),  # a population that does not fit goes in waves
        *(("equivariant", 8, 3, {"decisions": each, "kind": "evaluation"}) for each in ("zero", "wander", 0.5)),
    ],
)
def test_a_device_gives_the_cpus_numbers_with_two_waits_a_step(name, lanes, episodes, changed):
    found, waits = run(name, DeviceSimulator, lanes, strict_xp, episodes, **changed)
    assert_close(found, run(name, CpuSimulator, 8, episodes=episodes, **changed)[0])
    assert waits.min() == np.median(waits) == 2  # more where episodes ended
    assert (len(found) < 8) == (episodes == 1)


def test_lanes_of_a_device_start_together():
    started = []

    class Watched(DeviceSimulator):
        def reset(self, ids):
            started.append(len(ids))
            super().reset(ids)

    run("falls that end", Watched, 3, strict_xp)
    assert started == [9, 9, 6]


def test_the_noise_table_has_one_copy_on_a_device():
    table = NoiseTable(np.random.default_rng(0).standard_normal(1000, dtype=np.float32))
    assert table.on(np) is table
    copy = table.on(strict_xp)
    assert copy is table.on(strict_xp) is not table
    index, weights = np.array([0, 100, 7]), np.array([0.5, 0, -2], np.float32)
    on_device = weighted_noise_sum(copy, index, weights, 300)
    assert on_device.tobytes() == weighted_noise_sum(table, index, weights, 300).tobytes()


class DevicePlan(WorkerPlan):
    """A plan whose simulators lie on the stand-in for a device."""

    simulator = DeviceSimulator


BRANCHED = {"primitive_estimate": "interval", "primitive_view": "egocentric", "controller_interval": 3}


@pytest.mark.parametrize(
    ("env", "settings"),
    [
        ("point-gather", {"episodes_per_policy": 3}),
        ("point-push", {**BRANCHED, "primitive_population_size": 12, "horizon": 20}),
        ("ant-flagrun", {**BRANCHED, "symmetry": "dihedral", "horizon": 20}),
    ],
)
def test_generations_on_a_device_are_those_of_the_cpu(env, settings):
    """The states that the second one begins with come from the first one's device."""
    runs, learner = [], make(env, settings)
    for plan_class, xp in ((WorkerPlan, np), (DevicePlan, strict_xp)):
        plan = plan_class(**{field.name: getattr(learner.plan(), field.name) for field in fields(WorkerPlan)})
        backend = SerialBackend(partial(RolloutWorker, plan))
        reports = evolve(learner.start(1), learner.hyperparameters, learner.table.on(xp), backend)
        runs.append([next(reports) for _ in range(2)])
    for mine, theirs in zip(*runs, strict=True):
        for part in (
            lambda report: [level.theta for level in report.state.levels],
            lambda report: [population.results for population in report.populations],
            lambda report: report.state.running,
        ):
            assert_close(part(mine), part(theirs), 1e-3)
        assert bool(mine.populations[0].results.snapshots) == ("primitive_estimate" in settings)
        assert (mine.state.running is None) == (env == "point-gather")
