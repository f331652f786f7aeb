"""Where every setting of a run arrives: rollout, update rule, task, agent, workers, files.

Each row changes one setting and reads the value where it is used. A setting without a row fails.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from shes.algorithms.evolution.populations import generation_work
from shes.envs.tasks.maze import Maze
from shes.envs.worlds import is_free
from shes.errors import DivergenceError
from shes.runs.folder import RunFolder
from shes.runs.rooms import WorkerSettings, known_settings
from shes.runs.tables import read_csv
from shes.training.build import build_backend
from shes.training.divergence import Divergence
from tests.e2e import runs
from tests.training.built import INTERVALS, Built

CORES = WorkerSettings().count
STILL = {"reset_noise": 0.0, "evaluation_reset_noise": 0.0}


@dataclass(frozen=True)
class Row:
    """What a value of a setting changes."""

    value: Any
    place: Callable[[Built], Any]
    expected: Any
    usual: Any
    """What stands there without the setting."""
    env: str = "point-gather"
    beside: dict[str, Any] = field(default_factory=dict)
    """Settings of both."""


def rules(name):
    """Return what reads an attribute of the update rule of each level, and of the estimate by intervals."""
    return lambda b: [getattr(r, name) for r in (*b.rules, *([b.intervals.update] if b.intervals else []))]


def schedule(name):
    """Return what reads a schedule at its start, halfway, and at its end."""
    return lambda b: [round(getattr(b.settings, name).value(g), 6) for g in (0, 2, 4)]


def work(b):
    """Return the work of the first generation."""
    return generation_work(b.state, b.settings, b.config.evolution.noise_table_size)


def task(b, *, is_evaluation=False, num_episodes=64):
    """Return the task as a worker makes it, after a reset."""
    made = b.plan.env.make(num_episodes, b.plan.evaluation if is_evaluation else b.plan.training)
    made.reset(np.arange(num_episodes), range(num_episodes))
    return made


def spread(b, *, is_evaluation):
    """Return how far apart robots begin, as a share of reset noise 0.1."""
    return round(float(np.abs(task(b, is_evaluation=is_evaluation).sim.qpos).max()) / 0.1)


def fall_reward(b):
    """Return what an ant is paid that has fallen."""
    made = task(b, num_episodes=1)
    made.sim.qpos[:, 2] = 5.0
    made.step(np.array([0]), np.zeros((1, 8)))
    return float(made.reward[0])


def num_workers(b):
    with build_backend(b.config, b.plan) as backend:
        return backend.num_workers


def backend_option(name):
    """Return what reads an option of the backend."""

    def read(b):
        with build_backend(b.config, b.plan) as backend:
            return getattr(backend, name)

    return read


def backend_name(b):
    with build_backend(b.config, b.plan) as backend:
        return type(backend).__name__


def diverged_limit(b):
    """Return after how many generations in which every episode diverges a run ends."""
    count, generation = Divergence(b.config), 0
    while True:
        generation += 1
        count.add({"generation": generation, "diverged_rate": 1.0})
        try:
            count.check(is_over=False)
        except DivergenceError:
            return generation


def sizes(b):
    """Return the layers of each policy."""
    return [policy.sizes[1:-1] for policy in b.design.policies]


def all_free(b):
    """Tell whether every target of training is in a free cell."""
    return all(is_free(Maze.grid, *target) for target in task(b).target)


QUARTER = {"population_size": 400, "mirrored": "pair"}
BY_INTERVALS = {"env": "ant-gather", "beside": INTERVALS}
ROWS: dict[str, Row] = {
    # evolution
    "population_size": Row(24, lambda b: [b.settings.population_size, len(work(b).tasks)], [24, 6], [16, 4]),
    "episodes_per_policy": Row(3, lambda b: work(b).generation.episodes_per_policy, 3, 1),
    "sigma": Row(0.5, lambda b: work(b).generation.sigma, 0.5, 0.07),
    "learning_rate": Row(0.5, schedule("learning_rate"), [0.5] * 3, [0.01] * 3),
    "weight_decay": Row(0.25, rules("weight_decay"), [0.25] * 3, [0.005] * 3, **BY_INTERVALS),
    "weight_decay_form": Row("decoupled", rules("decouples_decay"), [True] * 3, [False] * 3, **BY_INTERVALS),
    "mirrored": Row("pair", lambda b: len(work(b).tasks), 8, 4),
    "fitness_shaping": Row(
        "z_score", lambda b: [type(r.shaping).__name__ for r in b.rules], ["ZScore"] * 2, ["CentredRanks"] * 2
    ),
    "hold_tied": Row(False, rules("holds_when_tied"), [False] * 3, [True] * 3, **BY_INTERVALS),
    "rank_ties": Row("index", lambda b: [r.shaping.rank_ties for r in b.rules], ["index"] * 2, ["average"] * 2),
    "top_fraction": Row(
        0.5, lambda b: [r.shaping.top_fraction for r in b.rules], [0.5] * 2, [0.2] * 2,
        beside={"fitness_shaping": "top_fraction"},
    ),
    "optimizer": Row("sgd", lambda b: [type(r.optimizer).__name__ for r in b.rules], ["SGD"] * 2, ["Adam"] * 2),
    "momentum": Row(
        0.5, lambda b: [r.optimizer.momentum for r in b.rules], [0.5] * 2, [0.9] * 2, beside={"optimizer": "sgd"}
    ),
    "common_random_numbers": Row(
        "population", lambda b: len({s for t in work(b).tasks for s in t.seeds}), 1, 4
    ),
    "statistics_fraction": Row(
        0.25, lambda b: np.mean([t.records_statistics for t in work(b).tasks]) < 0.5, True, False, beside=QUARTER
    ),
    "noise_table_size": Row(2_000_000, lambda b: b.table.size, 2_000_000, 1_000_000),
    # schedules
    "learning_rate_schedule": Row(
        "cosine", schedule("learning_rate"), [0.01, 0.005, 0.0], [0.01, 0.01, 0.01]
    ),
    "learning_rate_end": Row(0.004, schedule("learning_rate"), [0.01, 0.007, 0.004], [0.01] * 3),
    "sigma_schedule": Row("linear", schedule("sigma"), [0.07, 0.05, 0.03], [0.07] * 3),
    "sigma_end": Row(0.01, schedule("sigma"), [0.07, 0.04, 0.01], [0.07] * 3),
    "episodes_schedule": Row(
        "linear", lambda b: [b.settings.episodes(g) for g in (0, 2, 4)], [1, 3, 5], [1] * 3
    ),
    "episodes_end": Row(
        9, lambda b: [b.settings.episodes(g) for g in (0, 2, 4)], [1, 5, 9], [1] * 3
    ),
    "schedule_generations": Row(
        8, schedule("sigma"), [0.07, 0.06, 0.05], [0.07, 0.07, 0.07]
    ),
    # novelty
    "novelty": Row("ns", lambda b: type(b.settings.novelty).__name__, "NS", "NoneType"),
    "novelty_neighbours": Row(3, lambda b: b.settings.novelty_neighbours, 3, 10, beside={"novelty": "ns"}),
    # networks
    "hidden": Row((5, 6), sizes, [(5, 6)] * 2, [(16,)] * 2),
    "biases": Row(
        "glorot_normal", lambda b: [bool(np.all(level.theta)) for level in b.state.levels], [True] * 2, [False] * 2
    ),
    "output_weights": Row("zero", lambda b: b.output_layers(), [True] * 2, [False] * 2),
    "clock_frequency": Row(
        1.5, lambda b: b.design.clock and b.design.clock.frequency_hz, 1.5, None
    ),
    # hierarchy
    "controller_interval": Row(
        7,
        lambda b: (b.intervals.controller_interval, b.intervals.branch_steps, b.plan.branch_design.controller_interval),
        (7, 14, 7), (25, 50, 25), **BY_INTERVALS,
    ),
    "goal_distance": Row(
        2.5, lambda b: (b.intervals.goal_distance, b.design.goal_distance), (2.5, 2.5), (4, 4), **BY_INTERVALS
    ),
    "goal_encoding": Row("vector", lambda b: type(b.design.goal_encoding).__name__, "VectorEncoding", "AngleEncoding"),
    "primitive_reward": Row(
        "metres",
        lambda b: [type(d.primitive_reward).__name__ for d in (b.design, b.plan.branch_design)],
        ["MetresReward"] * 2, ["ProgressReward"] * 2, **BY_INTERVALS,
    ),
    "primitive_view": Row(
        "proprioception",
        lambda b: [type(d.primitive_view).__name__ for d in (b.design, b.plan.branch_design)],
        ["ColumnsView"] * 2, ["EgocentricView"] * 2, **BY_INTERVALS,
    ),
    "symmetry": Row(
        "rotation",
        lambda b: [d.symmetry and d.symmetry.num_elements for d in (b.design, b.plan.branch_design)],
        [4, 4], [None, None], **BY_INTERVALS,
    ),
    "hide_position": Row(True, lambda b: b.design.observation_sizes[1], 26, 28),
    "minimum_goal_distance": Row(False, lambda b: b.design.has_minimum_goal_distance, False, True),
    "controller_output": Row(
        "one_hot", lambda b: type(b.design.controller_output).__name__, "OneHotOutput", "VectorOutput"
    ),
    "controller_view": Row(
        "egocentric", lambda b: type(b.design.controller_view).__name__, "EgocentricView", "ColumnsView"
    ),
    "controller_weight_decay": Row(
        0.5, rules("weight_decay"), [0.5, 0.005, 0.005], [0.005] * 3, **BY_INTERVALS
    ),
    "perturbation": Row(
        "one_to_many", lambda b: type(b.settings.perturbation).__name__, "OneToMany", "ManyToMany"
    ),
    "primitive_hidden": Row((5, 6), sizes, [(16,), (5, 6)], [(16,)] * 2),
    # estimate
    "primitive_estimate": Row(
        "interval", lambda b: (b.intervals is None, b.plan.branch_design is None), (False, False), (True, True),
        env="ant-gather", beside={"primitive_view": "egocentric"},
    ),
    "primitive_fitness_shaping": Row(
        "z_score",
        lambda b: [type(r.shaping).__name__ for r in (*b.rules, b.intervals.update)],
        ["CentredRanks", "ZScore", "ZScore"], ["CentredRanks", "PairRanks", "PairRanks"], **BY_INTERVALS,
    ),
    "intervals": Row(
        3,
        lambda b: (b.intervals.intervals, b.intervals.branch_steps, b.plan.branch_design.num_goals),
        (3, 75, 3), (2, 50, 2), **BY_INTERVALS,
    ),
    "fall_price": Row(3.0, rules("fall_price"), [0, 3, 3], [0, 0, 0], **BY_INTERVALS),
    "primitive_population_size": Row(
        12, lambda b: (b.intervals.population_size, b.intervals.num_pairs), (12, 6), (8, 4), **BY_INTERVALS
    ),
    "primitive_sigma": Row(
        0.3, lambda b: [b.intervals.sigma.value(g) for g in (0, 9)], [0.3] * 2, [0.2] * 2, **BY_INTERVALS
    ),
    "primitive_learning_rate": Row(
        0.07, lambda b: [b.intervals.learning_rate.value(g) for g in (0, 9)], [0.07] * 2, [0.04] * 2, **BY_INTERVALS
    ),
    # episodes
    "horizon": Row(
        90, lambda b: (b.intervals.horizon, b.settings.horizon, b.plan.horizon), (90,) * 3, (70,) * 3, **BY_INTERVALS
    ),
    "evaluation_horizon": Row(90, lambda b: (b.plan.horizon, b.plan.evaluation_horizon), (50, 90), (50, 50)),
    "evaluation_reset_noise": Row(
        0.5, lambda b: [spread(b, is_evaluation=each) for each in (False, True)], [0, 5], [0, 0], beside=STILL
    ),
    # options of tasks
    "spec": Row(
        "hiro", lambda b: [task(b, is_evaluation=e).options.spec for e in (False, True)], ["hiro"] * 2, ["shes"] * 2
    ),
    "integrator": Row(
        "rk4", lambda b: [task(b, is_evaluation=e).sim.model.opt.integrator for e in (False, True)], [1] * 2, [0] * 2
    ),
    "reset_noise": Row(
        0.5, lambda b: [spread(b, is_evaluation=each) for each in (False, True)], [5, 0], [0, 0], beside=STILL
    ),
    "target_sampling": Row("free_cells", all_free, True, False, env="point-maze"),
    "target": Row((1.0, 2.0), lambda b: len(np.unique(task(b).target, axis=0)), 1, 64, env="point-maze"),
    "evaluation_target": Row(
        (1.0, 2.0), lambda b: task(b, is_evaluation=True).target[0].tolist(), [1, 2], [0, 16], env="point-maze"
    ),
    "observe_block": Row(
        False, lambda b: [task(b, is_evaluation=e).observe().shape[1] for e in (False, True)], [7, 7], [11, 11],
        env="point-push",
    ),
    "fall_penalty": Row(False, fall_reward, 0.0, -10.0, env="ant-gather", beside={"spec": "hiro"}),
    # workers
    "num_workers": Row(2, num_workers, 2, CORES, beside={"backend": "processes"}),
    "backend": Row("serial", backend_name, "SerialBackend", "ProcessesBackend"),
    "worker_warning_s": Row(
        5.0, backend_option("worker_warning_s"), 5.0, 60.0, beside={"backend": "processes", "num_workers": 1}
    ),
    "worker_timeout_s": Row(
        None, backend_option("worker_timeout_s"), None, 600.0, beside={"backend": "processes", "num_workers": 1}
    ),
    "chunk_size": Row(3, lambda b: b.plan.chunk_size, 3, 0),
    "device": Row("warp-cpu", lambda b: b.plan.device, "warp-cpu", "cpu"),
    "nconmax": Row(40, lambda b: b.plan.nconmax, 40, None, beside={"device": "warp-cpu"}),
    "njmax": Row(40, lambda b: b.plan.njmax, 40, None, beside={"device": "warp-cpu"}),
    # run
    "max_diverged_generations": Row(2, diverged_limit, 2, 10),
    "seed": Row(9, lambda b: b.state.seed, 9, 1),
}  # fmt: skip
BESIDE_IT = {
    "learning_rate_schedule": {"learning_rate_end": 0.0, "schedule_generations": 4},
    "learning_rate_end": {"learning_rate_schedule": "linear", "schedule_generations": 4},
    "sigma_schedule": {"sigma_end": 0.03, "schedule_generations": 4},
    "sigma_end": {"sigma_schedule": "linear", "schedule_generations": 4},
    "episodes_schedule": {"episodes_end": 5, "schedule_generations": 4},
    "episodes_end": {"episodes_schedule": "linear", "schedule_generations": 4},
    "schedule_generations": {"sigma_schedule": "linear", "sigma_end": 0.03},
}
"""What goes with the value of a setting, and not without it."""


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_arrives_where_it_is_used(name):
    row = ROWS[name]
    with_it = Built.of(row.env, **{**row.beside, **BESIDE_IT.get(name, {}), name: row.value})
    assert row.place(with_it) == row.expected
    assert row.place(Built.of(row.env, **row.beside)) == row.usual


# What shows in a run alone.


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A run to take a primitive and a controller from. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("source") / "run", generations=2, evaluation_interval=2)


def evaluations(path):
    return read_csv(path / "evaluation.csv")


def generation(path):
    return RunFolder.open(path).load("last").generation


def theta(path, checkpoint, level):
    return {each.name: each.theta.tobytes() for each in runs.state(path, checkpoint).levels}[level]


SHORT = {"generations": 3, "evaluation_interval": 3, "keep_checkpoints": 3}
SHOWN: dict[str, tuple[dict[str, Any], Callable[..., Any], Any]] = {
    # setting: (it and what goes with it, what shows it in the run's folder, what that is)
    "generations": ({"generations": 2}, lambda path, _: generation(path), 2),
    "env_steps": ({"env_steps": 1}, lambda path, _: generation(path), 1),
    "minutes": ({"minutes": 1e-9}, lambda path, _: generation(path), 0),
    "evaluation_interval": ({"evaluation_interval": 1}, lambda path, _: evaluations(path)["generation"], [1, 2, 3]),
    "evaluation_episodes": ({"evaluation_episodes": 5}, lambda path, _: evaluations(path)["episodes"], [5, 5]),
    "keep_checkpoints": (
        {"keep_checkpoints": 1}, lambda path, _: len(list(path.glob("checkpoints/generation_*.npz"))), 4
    ),
    "primitive": (
        {"primitive": "SOURCE"}, lambda path, s: theta(path, "0", "primitive") == theta(s, "best", "primitive"), True
    ),
    "primitive_checkpoint": (
        {"primitive": "SOURCE", "primitive_checkpoint": "0"},
        lambda path, s: theta(path, "0", "primitive") == theta(s, "0", "primitive"), True,
    ),
    "freeze_primitive": (
        {"primitive": "SOURCE", "freeze_primitive": False},
        lambda path, _: theta(path, "0", "primitive") == theta(path, "last", "primitive"), False,
    ),
    "controller": (
        {"controller": "SOURCE"}, lambda path, s: theta(path, "0", "controller") == theta(s, "best", "controller"), True
    ),
    "controller_checkpoint": (
        {"controller": "SOURCE", "controller_checkpoint": "0"},
        lambda path, s: theta(path, "0", "controller") == theta(s, "0", "controller"), True,
    ),
    "preset": ({}, lambda path, _: RunFolder.open(path).read_config().run.preset, "smoke"),
    "algorithm": (
        {"algorithm": "es"}, lambda path, _: [each.name for each in runs.state(path, "last").levels],
        ["policy"],
    ),
    "env": ({}, lambda path, _: RunFolder.open(path).read_config().run.env, "point-gather"),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_a_setting_shows_in_the_run(name, source, tmp_path):
    settings, show, expected = SHOWN[name]
    settings = {key: str(source) if value == "SOURCE" else value for key, value in settings.items()}
    assert show(runs.train_tiny(tmp_path / "run", **{**SHORT, **settings}), source) == expected


def test_every_setting_has_a_row():
    assert ROWS.keys() | SHOWN.keys() == known_settings().keys()
