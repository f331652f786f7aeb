"""Agents and roll-outs whose arrays lie on a device: the numbers of the CPU, two waits a step, and one place for noise.

The device is a stand-in, `strict_arrays`: it refuses what CuPy refuses. Weights lie elsewhere in memory than the CPU's,
so that a matmul may round differently: numbers agree to a tolerance, counts exactly.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shes.algorithms.evolution.algorithm import evolve
from shes.algorithms.evolution.populations import generation_work
from shes.backends.serial import SerialBackend
from shes.es.gradient import weighted_noise_sum
from shes.es.noise import NoiseTable
from shes.hierarchy.rollout import Rollout
from shes.runs.build import build_algorithm
from shes.sim.cpu import CpuSimulator
from shes.training.make_config import make_config
from tests.strict_arrays import strict_xp
from tests.strict_simulator import DeviceSimulator

HORIZON = 11
SETTINGS = {
    "hidden": (8,),
    "horizon": HORIZON,
    "population_size": 8,
    "episodes_per_policy": 3,
    "noise_table_size": 20_000,
    "backend": "serial",
    "num_workers": 1,
}
CHOICES = {
    "gather": ("point-gather", {}),
    "ant": ("ant-gather", {"primitive_estimate": "episode"}),
    "clock": ("point-maze", {"clock_frequency": 1.5}),
    "one-hot": ("point-push", {"controller_output": "one_hot", "minimum_goal_distance": True}),
    "unit vector": ("point-maze", {"goal_encoding": "unit_vector", "primitive_reward": "cosine"}),
    "vector": ("point-maze", {"goal_encoding": "vector", "primitive_reward": "negative_distance"}),
    "metres": ("point-fall", {"goal_encoding": "angle_metres", "minimum_goal_distance": True}),
    "hidden position": ("point-gather", {"hide_position": True}),
    "primitive alone": ("point-flagrun", {}),
    "flat": ("point-gather", {"algorithm": "es"}),
    "flat with a clock": ("point-gather", {"algorithm": "es", "clock_frequency": 1.5}),
    "one level in turns": ("point-gather", {"perturbation": "one_to_many"}),
    "egocentric": (
        "ant-gather",
        {
            "primitive_estimate": "episode",
            "primitive_view": "egocentric",
            "symmetry": "dihedral",
            "controller_network": "mlp",
            "controller_view": "egocentric",
            "controller_output": "heading_vector",
            "primitive_reward": "metres",
        },
    ),
    "equivariant": (
        "point-gather",
        {"controller_network": "equivariant", "controller_view": "sectors", "controller_output": "heading_direction"},
    ),
    "position": ("point-maze", {"controller_view": "position", "controller_output": "direction"}),
    "egocentric, alone": (
        "ant-flagrun",
        {"primitive_estimate": "episode", "primitive_view": "egocentric", "symmetry": "rotation", "max_tilt": 20.0},
    ),
    "falls that end": ("ant-maze", {"primitive_estimate": "episode", "max_tilt": 5.0}),
    "few statistics": ("point-gather", {"statistics_fraction": 0.5}),
}


def make(name, **more):
    """Return the learner of these settings."""
    env, settings = CHOICES[name]
    goals = {} if "algorithm" in settings else {"controller_interval": 4}
    config = make_config(env, "laptop", {**SETTINGS, **goals, **settings, **more})
    return build_algorithm(config)


def run(name, simulator, num_lanes, xp=np, episodes=3, **changed):
    """Return the results of a generation, by number, and the waits for the device of every step."""
    learner = make(name, episodes_per_policy=episodes)
    design, table, plan = learner.design, learner.table, learner.plan()
    work = generation_work(learner.start(1), learner.hyperparameters, table.size)
    tasks, generation = work.tasks, replace(work.generation, **changed)
    rollout = Rollout(
        design,
        lambda n: plan.env.make(n, plan.training, simulator),
        num_lanes,
        generation.rows_per_lane,
        HORIZON,
        generation.members_per_lane,
    )
    waits, step = [], rollout._step

    def counted():
        before = strict_xp.waits
        ended = step()
        waits.append(strict_xp.waits - before)
        return ended

    rollout._step = counted
    found = dict(rollout.run(iter(enumerate(tasks)), generation, table.on(xp)))
    return found, waits


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for number, mine in found.items():
        theirs = expected[number]
        for name in ("success", "steps", "has_terminated", "has_fallen", "has_diverged", "goals_reached"):
            assert np.array_equal(getattr(mine, name), getattr(theirs, name)), name
        for name in ("returns", "score", "final_position", "environment_returns"):
            assert type(getattr(mine, name)) is np.ndarray
            np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), rtol=1e-5, atol=1e-5, err_msg=name)
        assert (mine.moments is None) == (theirs.moments is None)
        for level, other in zip(mine.moments or (), theirs.moments or (), strict=True):
            assert np.array_equal(level.count, other.count)
            np.testing.assert_allclose(level.total, other.total, rtol=1e-5, atol=1e-4)
            np.testing.assert_allclose(level.total_squares, other.total_squares, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", CHOICES)
def test_a_device_gives_the_numbers_of_the_cpu_with_two_waits_a_step(name):
    found, waits = run(name, DeviceSimulator, 8, strict_xp)
    assert_same(found, run(name, CpuSimulator, 8)[0])
    assert set(waits) == {2}


@pytest.mark.parametrize("name", ["gather", "one-hot", "equivariant"])
def test_decisions_that_are_not_learned_are_those_of_the_cpu(name):
    ends = set()
    for decisions in ("zero", "random", "wander", 0.5):
        asked = {"decisions": decisions, "is_evaluation": True}
        found, waits = run(name, DeviceSimulator, 8, strict_xp, **asked)
        assert_same(found, run(name, CpuSimulator, 8, **asked)[0])
        assert set(waits) == {2}
        ends.add(found[0].final_position.tobytes())
    assert len(ends) == 4


@pytest.mark.parametrize("name", ["gather", "flat", "one level in turns"])
def test_members_that_share_their_noise_do_so_on_a_device(name):
    found, waits = run(name, DeviceSimulator, 2, strict_xp, episodes=1)
    assert len(found) < SETTINGS["population_size"]
    assert_same(found, run(name, CpuSimulator, 2, episodes=1)[0])
    assert set(waits) == {2}


def test_a_population_that_does_not_fit_goes_in_waves():
    assert_same(run("gather", DeviceSimulator, 3, strict_xp)[0], run("gather", CpuSimulator, 8)[0])


def test_lanes_of_a_device_start_together():
    started = []

    class Watched(DeviceSimulator):
        def reset(self, ids):
            started.append(len(ids))
            super().reset(ids)

    run("gather", Watched, 3, strict_xp)
    assert started == [9, 9, 6]


def test_the_noise_table_has_one_copy_on_a_device():
    table = NoiseTable(np.random.default_rng(0).standard_normal(1000, dtype=np.float32))
    assert table.on(np) is table
    copy = table.on(strict_xp)
    assert copy is table.on(strict_xp) is not table
    index, weights = np.array([0, 100, 7]), np.array([0.5, 0, -2], np.float32)
    on_device = weighted_noise_sum(copy, index, weights, 300)
    assert on_device.tobytes() == weighted_noise_sum(table, index, weights, 300).tobytes()


class Worker:
    """Runs roll-outs here, on the CPU or on the device."""

    def __init__(self, design, plan, table, simulator):
        self.rollout = Rollout(design, lambda n: plan.env.make(n, plan.training, simulator), 8, 3, HORIZON)
        self.table = table

    def receive(self, state):
        self.generation = state

    def close(self):
        pass

    def run(self, work, share):
        return self.rollout.run(iter(work), self.generation, self.table)


def test_a_generation_on_a_device_updates_as_on_the_cpu():
    states = []
    for simulator, xp in ((CpuSimulator, np), (DeviceSimulator, strict_xp)):
        learner = make("gather")
        design, table, plan = learner.design, learner.table, learner.plan()
        settings, state = learner.hyperparameters, learner.start(1)
        backend = SerialBackend(partial(Worker, design, plan, table.on(xp), simulator))
        states.append(next(evolve(state, settings, table.on(xp), backend)).state)
    for mine, theirs in zip(states[1].levels, states[0].levels, strict=True):
        assert type(mine.theta) is np.ndarray
        np.testing.assert_allclose(mine.theta, theirs.theta, rtol=1e-5, atol=1e-5)


class BranchingWorker:
    """Runs whole episodes and branches here, on the CPU or on the device."""

    def __init__(self, plan, table, simulator):
        self.plan, self.table, self.simulator = plan, table, simulator

    def receive(self, state):
        self.generation = state

    def close(self):
        pass

    def run(self, work, share):
        plan, generation = self.plan, self.generation
        is_branch = generation.branch_steps > 0
        design = plan.branch_design if is_branch and plan.branch_design is not None else plan.design
        rollout = Rollout(
            design,
            lambda n: plan.env.make(n, plan.training, self.simulator),
            8,
            generation.rows_per_lane,
            generation.branch_steps or HORIZON,
            generation.members_per_lane,
        )
        return rollout.run(iter(work), generation, self.table)


BRANCHES = {
    "beside a controller": ("point-push", {"primitive_view": "egocentric", "primitive_population_size": 12}),
    "alone": ("ant-flagrun", {"primitive_view": "egocentric", "symmetry": "dihedral", "horizon": 20}),
}


@pytest.mark.parametrize("name", BRANCHES)
def test_branches_on_a_device_begin_and_end_as_on_the_cpu(name):
    """In two generations: the states that the second one begins with come from the first one's device."""
    env, settings = BRANCHES[name]
    more = {"primitive_estimate": "interval", "controller_interval": 3}
    alike = {name: value for name, value in SETTINGS.items() if name != "episodes_per_policy"}
    config = make_config(env, "laptop", {**alike, **settings, **more})
    learner, runs = build_algorithm(config), []
    table, plan = learner.table, learner.plan()
    for simulator, xp in ((CpuSimulator, np), (DeviceSimulator, strict_xp)):
        state = learner.start(config.run.seed)
        backend = SerialBackend(partial(BranchingWorker, plan, table.on(xp), simulator))
        reports = evolve(state, learner.hyperparameters, table.on(xp), backend)
        runs.append([next(reports) for _ in range(2)])
    for mine, theirs in zip(*runs, strict=True):
        pairs, others = (report.branches or report.population for report in (mine, theirs))
        np.testing.assert_allclose(pairs.results.returns, others.results.returns, rtol=1e-4, atol=1e-4)
        snapshots = [report.population.results.snapshots for report in (mine, theirs)]
        assert snapshots[0].keys() == snapshots[1].keys() != set()
        for place, left in snapshots[0].items():
            assert type(left.state) is type(left.goals) is np.ndarray
            assert left.steps == snapshots[1][place].steps
            np.testing.assert_allclose(left.state, snapshots[1][place].state, rtol=1e-4, atol=1e-3)
            np.testing.assert_allclose(left.goals, snapshots[1][place].goals, rtol=1e-4, atol=1e-4)
        assert (mine.state.running is None) == (theirs.state.running is None) == (name == "beside a controller")
