"""Where every setting of a run arrives: rollouts, updates, tasks, agents, workers, files.

Each row runs one tiny generation with a setting and one without it, records the two (`recorder`), and compares what
was done. Settings of the run itself are read from its folder. A setting without a row fails.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shes.baselines.learner_settings import HIRO_SECTIONS
from shes.envs.tasks.mazes import Maze
from shes.envs.worlds import is_free
from shes.evolution.estimates import draw_pairs
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.run_settings import known_settings
from shes.runs.tables import read_csv
from shes.settings import setting_fields
from shes.streams import Purpose, stream
from tests.e2e import runs
from tests.runs.built import INTERVALS
from tests.runs.recorder import record_generations, recording

STILL = {"reset_noise": 0.0}


@dataclass(frozen=True)
class Row:
    """What a value of a setting changes."""

    value: Any
    place: Callable[..., Any]
    """Reads it from the record of a run."""
    expected: Any
    usual: Any
    """What stands there without the setting."""
    env: str = "point-gather"
    beside: dict[str, Any] = field(default_factory=dict)
    """Settings of both."""
    with_it: dict[str, Any] = field(default_factory=dict)
    """Settings that the value needs, and that the run without it lacks."""
    generations: tuple[int, ...] = (0,)


def kinds(record):
    """Return the rollouts of training, then those of branches, if any: one of each."""
    return [record.of(kind)[0] for kind in ("training", "branch") if record.of(kind)]


def design(read):
    """Return what reads an attribute of the agents' design in training, and in branches, if any."""
    return lambda r: [read(each.rollout.design) for each in kinds(r)]


def designed(name):
    """Return what reads the class of a part of the agents' design."""
    return design(lambda each: type(getattr(each, name)).__name__)


def batches(read):
    """Return what reads the task of training and that of evaluation, each after a reset."""

    def place(record):
        found = []
        for kind in ("training", "evaluation"):
            batch = record.of(kind)[0].rollout.batch
            rows = np.arange(len(batch.position))
            batch.reset(rows, rows.tolist())
            found.append(read(batch))
        return found

    return place


def spread(batch):
    """Return how far apart robots begin, as a share of reset noise 0.1."""
    return round(float(np.abs(batch.sim.qpos).max()) / 0.1)


def rules(name):
    """Return what reads an attribute of the rule of every update."""
    return lambda r: [getattr(update.rule, name) for update in r.updates]


def stays(record):
    """Tell of every update whether the parameters stayed the same."""
    return [np.array_equal(each.before.theta, each.result.level.theta) for each in record.updates]


def learning_rates(record):
    """Return the learning rates of all updates, equal neighbours once."""
    rates = [round(update.learning_rate, 6) for update in record.updates]
    return [rate for i, rate in enumerate(rates) if rates[max(i - 1, 0)] != rate or i == 0]


def sigmas(kind="training"):
    """Return what reads the standard deviation of the perturbations in every generation."""
    return lambda r: [round(each.generation.sigma, 6) for each in r.of(kind)]


def episodes(record):
    """Return the number of episodes of a member in every generation."""
    return [sum(len(t.seeds) for t in each.tasks) / each.num_members for each in record.of("training")]


def perturbed(record):
    """Return which levels are perturbed in every generation, by any member."""
    return [np.abs([s for t in each.tasks for s in t.signs]).max(axis=0).tolist() for each in record.of("training")]


def recorded_share(record):
    """Return the share of the steps of training that entered the statistics of the primitive."""
    return record.state.levels[-1].statistics.count / record.state.env_steps


def theta(read):
    """Return what reads the initial parameters of each level, as a worker receives them."""
    return lambda r: [read(level.theta, policy) for level, policy in zip(
        r.of("training")[0].generation.levels, r.of("training")[0].rollout.design.policies, strict=True
    )]  # fmt: skip


def output_layer(parameters, policy):
    """Return the parameters of the last layer."""
    return parameters[-(policy.sizes[-2] + 1) * policy.sizes[-1] :]


def goals_within(record, distance):
    """Tell whether the goals of branches that begin at a reset are within `distance`."""
    before = SimpleNamespace(results=SimpleNamespace(snapshots={}))
    draws = draw_pairs(record.state, record.algorithm.hyperparameters, 1_000_000, (before,))
    return max(float(np.abs(task.start.goals).max()) for task in draws.tasks) <= distance


def buffers(name):
    """Return what reads an argument of all simulators of a device."""
    return lambda r: {simulator[name] for simulator in r.device_simulators}


def first_seed(seed):
    """Return the seed of the first episode of a run with this seed."""
    return int(stream(seed, Purpose.TRAINING_EPISODES, 0).integers(0, 2**63))


sizes = design(lambda each: [policy.sizes[1:-1] for policy in each.policies])
BY_INTERVALS = {"beside": INTERVALS}
START_MIDDLE_END = {"generations": (0, 2, 4)}
UNPAID = {"horizon": 2}  # too short for an apple: all controllers have the same fitness
ROWS: dict[str, Row] = {
    # evolution
    "population_size": Row(24, lambda r: r.of("training")[0].num_members, 24, 16),
    "episodes_per_policy": Row(3, episodes, [3], [1]),
    "sigma": Row(0.5, sigmas(), [0.5], [0.07]),
    "learning_rate": Row(0.5, learning_rates, [0.5], [0.01]),
    "weight_decay": Row(0.25, rules("weight_decay"), [0.25] * 2, [0.005] * 2, **BY_INTERVALS),
    "mirrored": Row("pair", lambda r: len(r.of("training")[0].tasks), 8, 4),
    "fitness_shaping": Row(
        "pair_rank", lambda r: [type(u.rule.shaping).__name__ for u in r.updates], ["PairRanks"] * 2,
        ["CentredRanks"] * 2, beside={"mirrored": "pair"},
    ),
    "rank_ties": Row(
        "index", lambda r: [bool(update.shaped.any()) for update in r.updates], [True, True], [False, True],
        beside=UNPAID,
    ),
    "rank_ties of a level that ties": Row("index", stays, [False, False], [True, False], beside=UNPAID),
    "optimizer": Row(
        "sgd", lambda r: [sorted(u.result.level.optimizer.slots) for u in r.updates],
        [["velocity"]] * 2, [["first", "second"]] * 2,
    ),
    "common_random_numbers": Row("population", lambda r: len(r.seeds("training")), 1, 4),
    "statistics_fraction": Row(
        0.25, lambda r: recorded_share(r) < 0.5, True, False, beside={"population_size": 40, "mirrored": "pair"}
    ),
    "noise_table_size": Row(2_000_000, lambda r: r.of("training")[0].table.size, 2_000_000, 1_000_000),
    "learning_rate_end": Row(
        0.0025, learning_rates, [0.01, 0.005, 0.0025], [0.01],
        with_it={"schedule_generations": 4}, **START_MIDDLE_END,
    ),
    "learning_rate_end in branches": Row(
        0.01, learning_rates, [0.04, 0.02, 0.01], [0.04],
        with_it={"schedule_generations": 4},
        **BY_INTERVALS, **START_MIDDLE_END,
    ),
    "sigma_end": Row(
        0.28, sigmas(), [0.07, 0.14, 0.28], [0.07] * 3,
        with_it={"schedule_generations": 4}, **START_MIDDLE_END,
    ),
    "sigma_end in branches": Row(
        0.05, sigmas("branch"), [0.2, 0.1, 0.05], [0.2] * 3,
        with_it={"schedule_generations": 4}, **BY_INTERVALS, **START_MIDDLE_END,
    ),
    "schedule_generations": Row(
        8, sigmas(), [0.07, 0.14, 0.28], [0.07] * 3,
        with_it={"sigma_end": 1.12}, **START_MIDDLE_END,
    ),
    # exploration
    "explore": Row(
        "archive", lambda r: (bool(r.of("exploration")), bool(r.state.archive)), (True, True), (False, False),
        env="point-push", beside={"primitive_view": "egocentric", "controller_interval": 5},
    ),
    "explore_horizon": Row(
        5, lambda r: max(task.start.steps for each in r.of("exploration") for task in each.tasks), 0, 45,
        env="point-push", beside={"primitive_view": "egocentric", "controller_interval": 5, "explore": "archive"},
    ),
    # networks
    "hidden": Row((5, 6), sizes, [[(5, 6)] * 2], [[(16,)] * 2]),
    "biases": Row("glorot_normal", theta(lambda values, _: bool(np.all(values))), [True] * 2, [False] * 2),
    "output_weights": Row(
        "zero", theta(lambda *each: bool(output_layer(*each).any())), [False] * 2, [True] * 2
    ),
    "clock_frequency": Row(
        1.5, design(lambda d: d.clock and d.clock.frequency_hz), [1.5] * 2, [None] * 2, **BY_INTERVALS
    ),
    # hierarchy
    "controller_interval": Row(
        7,
        lambda r: (
            design(lambda d: d.controller_interval)(r),
            r.of("branch")[0].generation.branch_steps,
            int(np.gcd.reduce([step for task in r.of("training")[0].tasks for step in task.snapshot_steps])),
        ),
        ([7, 7], 14, 7), ([25, 25], 50, 25), **BY_INTERVALS,
    ),
    "goal_distance": Row(
        2.5, lambda r: (r.of("training")[0].rollout.design.controller.goal_distance, goals_within(r, 2.5)),
        (2.5, True), (4, False), **BY_INTERVALS,
    ),
    "goal_encoding": Row(
        "vector", designed("goal_encoding"), ["VectorEncoding"] * 2, ["AngleEncoding"] * 2, **BY_INTERVALS
    ),
    "primitive_reward": Row(
        "metres", designed("primitive_reward"), ["MetresReward"] * 2, ["ProgressReward"] * 2, **BY_INTERVALS
    ),
    "primitive_view": Row(
        "proprioception", designed("primitive_view"), ["ColumnsView"] * 2, ["EgocentricView"] * 2, **BY_INTERVALS
    ),
    "symmetry": Row(
        "rotation", design(lambda d: d.symmetry and d.symmetry.num_elements), [4, 4], [None, None],
        env="ant-gather", **BY_INTERVALS,
    ),
    "minimum_goal_distance": Row(False, design(lambda d: d.controller.has_minimum_goal_distance), [False], [True]),
    "controller_output": Row(
        "one_hot", design(lambda d: type(d.controller.output).__name__), ["OneHotOutput"], ["VectorOutput"]
    ),
    "controller_view": Row("egocentric", designed("controller_view"), ["EgocentricView"], ["ColumnsView"]),
    "controller_network": Row(
        "equivariant", design(lambda d: type(d.controller.network).__name__), ["EquivariantMLP"], ["MLP"],
        beside={"controller_view": "sectors", "controller_output": "heading_direction"},
    ),
    "perturbation": Row("one_to_many", perturbed, [[1, 0], [0, 1]], [[1, 1]] * 2, generations=(0, 1)),
    "primitive_hidden": Row((5, 6), sizes, [[(16,), (5, 6)]], [[(16,)] * 2]),
    # estimate
    "primitive_estimate": Row(
        "interval", lambda r: len(kinds(r)), 2, 1, beside={"primitive_view": "egocentric"}
    ),
    "intervals": Row(
        1,
        lambda r: (
            r.of("training")[0].generation.snapshot_goals,
            r.of("branch")[0].generation.branch_steps,
            r.of("branch")[0].rollout.design.num_recorded_goals,
        ),
        (1, 25, 1), (2, 50, 2), **BY_INTERVALS,
    ),
    "fall_price": Row(3.0, rules("fall_price"), [0, 3], [0, 0], **BY_INTERVALS),
    "primitive_population_size": Row(12, lambda r: r.of("branch")[0].num_members, 12, 8, **BY_INTERVALS),
    "primitive_sigma": Row(0.3, sigmas("branch"), [0.3] * 2, [0.2] * 2, **BY_INTERVALS, generations=(0, 9)),
    "primitive_learning_rate": Row(0.07, learning_rates, [0.04, 0.07], [0.04], **BY_INTERVALS),
    # episodes
    "horizon": Row(
        90,
        lambda r: (
            r.of("training")[0].steps,
            max(step for task in r.of("training")[0].tasks for step in task.snapshot_steps),
        ),
        (90, 75), (70, 50), **BY_INTERVALS,
    ),
    "horizon of running episodes": Row(
        90, lambda r: r.state.running is not None, True, False,
        env="point-flagrun", beside={"primitive_estimate": "interval"},
    ),
    "evaluation_horizon": Row(
        90, lambda r: (r.of("training")[0].steps, int(r.evaluation.steps.max())), (50, 90), (50, 50)
    ),
    # options of tasks
    "spec": Row("hiro", batches(lambda b: b.options.spec), ["hiro"] * 2, ["shes"] * 2),
    "integrator": Row("rk4", batches(lambda b: b.sim.model.opt.integrator), [1] * 2, [0] * 2),
    "reset_noise": Row(0.5, batches(spread), [5, 1], [0, 1], beside=STILL),
    "target_sampling": Row(
        "free_cells", lambda r: batches(lambda b: all(is_free(Maze.grid, *each) for each in b.target))(r)[0],
        True, False, env="point-maze",
    ),
    "target": Row(
        (1.0, 2.0), lambda r: batches(lambda b: len(np.unique(b.target, axis=0)))(r)[0], 1, 16, env="point-maze"
    ),
    "evaluation_target": Row(
        (1.0, 2.0), lambda r: batches(lambda b: b.target[0].tolist())(r)[1], [1, 2], [0, 16], env="point-maze"
    ),
    "stiff_contacts": Row(
        True, batches(lambda b: set(b.sim.model.geom_solimp[:, 0])), [{0.995}] * 2, [{0.8}] * 2, env="point-flagrun"
    ),
    "max_tilt": Row(
        60.0, batches(lambda b: b._min_cos_tilt and round(b._min_cos_tilt, 9)), [0.5, None], [None] * 2,
        env="ant-gather",
    ),
    "waypoints": Row(
        (-8.0, 8.0), batches(lambda b: b._num_waypoints), [1, 0], [0, 0], env="point-push"
    ),
    "observe_block": Row(False, batches(lambda b: b.observe().shape[1]), [7, 7], [11, 11], env="point-push"),
    # workers
    "num_workers": Row(2, lambda r: r.num_processes, 2, 1, beside={"backend": "processes"}),
    "backend": Row(
        "processes", lambda r: r.backend, "ProcessesBackend", "SerialBackend", beside={"num_workers": 2}
    ),
    "chunk_size": Row(8, lambda r: r.of("training")[0].rollout.num_lanes, 2, 4),
    "device": Row("warp-cpu", buffers("device"), {"warp-cpu"}, set()),
    "nconmax": Row(40, buffers("nconmax"), {40}, {None}, beside={"device": "warp-cpu"}),
    "njmax": Row(40, buffers("njmax"), {40}, {None}, beside={"device": "warp-cpu"}),
    # run
    "seed": Row(9, lambda r: r.of("training")[0].tasks[0].seeds[0], first_seed(9), first_seed(1)),
}  # fmt: skip
"""A row for every setting, by its name. Words after the name tell several places apart."""


def setting_of(row):
    """Return the setting of a row."""
    return row.partition(" ")[0]


SHORT = {"horizon": 10, "evaluation_horizon": 10}
"""Where neither an interval nor an episode has to end, a few steps tell as much."""


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_arrives_where_it_is_used(name):
    row = ROWS[name]
    is_long = row.beside is INTERVALS or "horizon" in name
    beside = row.beside if is_long else {**SHORT, **row.beside}
    settings = {**beside, **row.with_it, setting_of(name): row.value}
    assert row.place(record_generations(row.env, settings, row.generations)) == row.expected
    assert row.place(record_generations(row.env, beside, row.generations)) == row.usual


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
    "preset": ({}, lambda path, _: RunFolder.open(path).read_config().run.preset, "smoke"),
    "algorithm": (
        {"algorithm": "es"}, lambda path, _: [each.name for each in runs.state(path, "last").levels],
        ["policy"],
    ),
    "env": ({}, lambda path, _: RunFolder.open(path).read_config().run.env, "point-gather"),
    "seed": ({"seed": 9}, lambda path, _: runs.state(path).seed, 9),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_a_setting_shows_in_the_run(name, source, tmp_path):
    settings, show, expected = SHOWN[name]
    settings = {key: str(source) if value == "SOURCE" else value for key, value in settings.items()}
    assert show(runs.train_tiny(tmp_path / "run", **{**SHORT, **settings}), source) == expected


def test_every_setting_has_a_row():
    of_hiro = {name for section in HIRO_SECTIONS.values() for name in setting_fields(section)}  # tests/baselines
    rows = {setting_of(row) for row in ROWS} | SHOWN.keys()
    assert rows | of_hiro == known_settings().keys() - {"max_diverged_generations"}  # which is fixed


def test_training_evaluation_and_the_final_evaluation_share_no_episode(tmp_path):
    # An evaluation after generation 1 has the key of the second generation of training: only the purpose differs.
    with recording() as record:
        path = runs.train_tiny(tmp_path / "run", generations=3, evaluation_interval=1)
    with recording() as final:
        evaluate(path, checkpoint="last", episodes=3, num_workers=1)
    seeds = [record.seeds("training"), record.seeds("evaluation"), final.seeds("evaluation")]
    assert [len(each) for each in seeds] == [6, 9, 3]
    assert len(set.union(*seeds)) == 18


@pytest.mark.parametrize(
    ("is_frozen", "noises"), [(True, {"decision_noise"}), (False, {"decision_noise", "control_noise"})]
)
def test_a_frozen_primitive_has_no_exploration_noise(source, tmp_path, is_frozen, noises):
    with recording() as record:
        runs.train_tiny(tmp_path / "run", primitive=str(source), freeze_primitive=is_frozen, generations=1)
    assert record.noises == noises
