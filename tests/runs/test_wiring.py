"""Where every setting of a run arrives: rollouts, updates, tasks, agents.

Each group runs a tiny generation with several settings and one without them, records the two (`recorder`), and compares
what was done. Settings of the run itself are read from its folder. A setting without a row fails.
"""

from collections.abc import Callable, Mapping
from itertools import groupby
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

import shes
from shes.baselines.hiro import HIRO
from shes.evolution.estimates import draw_pairs
from shes.runs.config import known_settings
from shes.settings import setting_fields
from shes.streams import Purpose, stream
from tests.e2e import runs
from tests.envs.robot_files import ASSETS
from tests.runs.recorder import record_generations, recording


class Row(NamedTuple):
    """What a value of a setting changes."""

    value: Any
    place: Callable[..., Any]
    """Reads it from the record of a run."""
    expected: Any
    """What stands there, and does not without the setting."""


class Group(NamedTuple):
    """Settings that are tried together. Their values are different, so that none can stand in for another."""

    rows: dict[str, Row]
    env: str = "point-gather"
    common: Mapping[str, Any] = MappingProxyType({})
    """Settings of both runs."""
    generations: tuple[int, ...] = (0,)


def design(read):
    """Return what reads an attribute of the agents' design in training, and in branches, if any."""
    return lambda r: [read(r.of(kind)[0].rollout.design) for kind in ("training", "branch") if r.of(kind)]


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


def rules(name):
    """Return what reads an attribute of the rule of every update."""
    return lambda r: [getattr(update.rule, name) for update in r.updates]


def learning_rates(record):
    """Return the learning rates of all updates, equal neighbours once."""
    return [rate for rate, _ in groupby(round(update.learning_rate, 6) for update in record.updates)]


def sigmas(kind="training"):
    """Return what reads the standard deviation of the perturbations in every generation."""
    return lambda r: [round(each.generation.sigma, 6) for each in r.of(kind)]


def tasks(record):
    """Return the tasks of the first generation of training."""
    return record.of("training")[0].tasks


def num_members(kind="training"):
    """Return what reads the number of members."""
    return lambda r: sum(len(task.signs) for task in r.of(kind)[0].tasks)


def longest(record):
    """Return the number of steps of the longest episode of training."""
    return max(int(each.outcomes["steps"].max()) for each in record.of("training")[0].results)


def perturbed(record):
    """Return which levels are perturbed in every generation, by any member."""
    return [np.abs([s for t in each.tasks for s in t.signs]).max(axis=0).tolist() for each in record.of("training")]


def theta(read):
    """Return what reads the initial parameters of each level, as a worker receives them."""

    def place(record):
        own = record.of("training")[0]
        return [read(*each) for each in zip(own.generation.levels, own.rollout.design.policies, strict=True)]

    return place


def goals_within(record, distance):
    """Tell whether the goals of branches that begin at a reset are within `distance`."""
    before = SimpleNamespace(results=SimpleNamespace(snapshots={}))
    draws = draw_pairs(record.state, record.algorithm.hyperparameters, 1_000_000, (before,))
    return max(float(np.abs(task.start.goals).max()) for task in draws.tasks) <= distance


SHORT = {"horizon": 10, "evaluation_horizon": 10}
"""Where neither an interval nor an episode has to end, a few steps tell as much."""
BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric"}
INTERVALS = {**BRANCHES, "population_size": 8, "sigma": 0.2, "learning_rate": 0.04, "horizon": 70}
BRIEF = {**INTERVALS, "horizon": 12, "controller_interval": 5}
SCHEDULED = {"common": BRIEF, "generations": (0, 4, 8)}
GROUPS: dict[str, Group] = {
    "evolution": Group({
        "population_size": Row(24, num_members(), 24),
        "episodes_per_policy": Row(3, lambda r: {len(task.seeds) / len(task.signs) for task in tasks(r)}, {3}),
        "sigma": Row(0.5, sigmas(), [0.5]),
        "learning_rate": Row(0.45, learning_rates, [0.45]),
        "weight_decay": Row(0.25, rules("weight_decay"), [0.25] * 2),
        "fall_price": Row(2.0, rules("fall_price"), [0, 2]),
        "mirrored": Row("pair", lambda r: num_members()(r) / len({task.noise_index for task in tasks(r)}), 2),
        "fitness_shaping": Row("pair_rank", lambda r: [type(u.rule.shaping).__name__ for u in r.updates],
                               ["PairRanks"] * 2),
        "optimizer": Row("sgd", lambda r: [[*u.result.level.optimizer.slots] for u in r.updates], [["velocity"]] * 2),
        "common_random_numbers": Row("population", lambda r: len({*r.seeds("training")}), 3),
        "statistics_fraction": Row(0.25, lambda r: r.state.levels[-1].statistics.count / r.state.env_steps < 0.5, True),
        "noise_table_size": Row(2_000_000, lambda r: r.of("training")[0].table.size, 2_000_000),
        "hidden": Row((5, 6), design(lambda d: d.policies[0].sizes[1:-1]), [(5, 6)]),
        "primitive_hidden": Row((3,), design(lambda d: d.policies[1].sizes[1:-1]), [(3,)]),
        "biases": Row("glorot_normal", theta(lambda own, _: bool(np.all(own.theta))), [True] * 2),
        "minimum_goal_distance": Row(False, design(lambda d: d.has_minimum_goal_distance), [False]),
        "controller_output": Row("one_hot", design(lambda d: type(d.controller_output).__name__), ["OneHotOutput"]),
        "controller_view": Row("egocentric", designed("controller_view"), ["EgocentricView"]),
        "evaluation_horizon": Row(12, lambda r: (longest(r), int(r.evaluation.steps.max())), (10, 12)),
        "spec": Row("hiro", batches(lambda b: b.options.spec), ["hiro"] * 2),
        "integrator": Row("rk4", batches(lambda b: b.sim.model.opt.integrator), [1] * 2),
        "reset_noise": Row(0.5, batches(lambda b: round(float(np.abs(b.sim.qpos).max()) / 0.1)), [5, 1]),
        "chunk_size": Row(8, lambda r: r.of("training")[0].rollout.num_lanes, 8),
        "seed": Row(9, lambda r: tasks(r)[0].seeds[0],
                    int(stream(9, Purpose.TRAINING_EPISODES, 0).integers(0, 2**63))),
    }, common={**SHORT, "reset_noise": 0.0}),
    "intervals": Group({
        "clock_frequency": Row(1.5, design(lambda d: d.clock and d.clock.frequency_hz), [1.5] * 2),
        "controller_interval": Row(7, lambda r: (
            design(lambda d: d.controller_interval)(r),
            r.of("branch")[0].generation.branch_steps,
            int(np.gcd.reduce(np.ravel([task.snapshot_steps for task in tasks(r)]))),
        ), ([7, 7], 21, 7)),
        "intervals": Row(3, lambda r: (r.of("training")[0].generation.snapshot_goals,
                                       r.of("branch")[0].rollout.design.num_recorded_goals), (3, 3)),
        "horizon": Row(90, lambda r: (longest(r), int(np.max([task.snapshot_steps for task in tasks(r)]))), (90, 77)),
        "goal_distance": Row(
            2.5, lambda r: (r.of("training")[0].rollout.design.goal_distance, goals_within(r, 2.5)),
            (2.5, True),
        ),
        "goal_encoding": Row("vector", designed("goal_encoding"), ["VectorEncoding"] * 2),
        "primitive_reward": Row("metres", designed("primitive_reward"), ["MetresReward"] * 2),
        "primitive_view": Row("proprioception", designed("primitive_view"), ["ColumnsView"] * 2),
        "output_weights": Row("zero", theta(lambda own, of: bool(own.theta[-(of.sizes[-2] + 1) * of.sizes[-1]:].any())),
                              [False] * 2),
        "fall_price": Row(3.0, rules("fall_price"), [0, 3]),
        "weight_decay": Row(0.25, rules("weight_decay"), [0.25] * 2),
        "practice": Row(1, lambda r: [each.generation.decisions for each in r.of("training")], ["wander"]),
        "primitive_population_size": Row(12, num_members("branch"), 12),
        "primitive_sigma": Row(0.3, sigmas("branch"), [0.3]),
        "primitive_learning_rate": Row(0.07, learning_rates, [0.04, 0.07]),
    }, common=INTERVALS),
    "schedules": Group({
        "sigma_end": Row(0.05, lambda r: [sigmas("training")(r), sigmas("branch")(r)], [[0.2, 0.1, 0.05]] * 2),
        "learning_rate_end": Row(0.01, learning_rates, [0.04, 0.02, 0.01]),
        "schedule_generations": Row(8, sigmas(), [0.2, 0.1, 0.05]),
    }, **SCHEDULED),
    "schedules and a sigma of the primitive's own": Group({
        "primitive_sigma": Row(0.3, sigmas("branch"), [0.3] * 3),
        "sigma_end": Row(0.05, sigmas(), [0.2, 0.1, 0.05]),
        "schedule_generations": Row(8, sigmas(), [0.2, 0.1, 0.05]),
    }, **SCHEDULED),
    "estimate": Group({
        "primitive_estimate": Row("interval", lambda r: (len(r.of("branch")), perturbed(r)), (1, [[1, 0]])),
    }, common={**SHORT, "primitive_view": "egocentric"}),
    "ties": Group({
        "fitness_shaping": Row("centred_rank_index", rules("holds_when_tied"), [False] * 2),
    }, common=SHORT),
    "controller": Group({
        "perturbation": Row("one_to_many", perturbed, [[1, 0], [0, 1]]),
        "controller_network": Row("equivariant", design(lambda d: type(d.networks["controller"]).__name__),
                                  ["EquivariantMLP"]),
    }, common={**SHORT, "controller_view": "sectors", "controller_output": "heading_direction"}, generations=(0, 1)),
    "push": Group({
        "explore": Row("archive", lambda r: (bool(r.of("exploration")), bool(r.state.archive)), (True, True)),
        "explore_horizon": Row(
            5, lambda r: max((task.start.steps for each in r.of("exploration") for task in each.tasks), default=None), 0
        ),
    }, env="point-push", common={**SHORT, "primitive_view": "egocentric", "controller_interval": 5}),
    "maze": Group({
        "target": Row((1.0, 2.0), batches(lambda b: np.unique(b.target, axis=0).tolist()), [[[1, 2]]] * 2),
    }, env="point-maze", common=SHORT),
    "ant": Group({
        "symmetry": Row("rotation", design(lambda d: d.symmetry and len(d.symmetry.view_index)), [4, 4]),
        "max_tilt": Row(60.0, batches(lambda b: b.min_cos_tilt and round(b.min_cos_tilt, 9)), [0.5, None]),
    }, env="ant-gather", common=BRIEF),
    "contacts": Group({
        "stiff_contacts": Row(True, batches(lambda b: set(b.sim.model.geom_solimp[:, 0])), [{0.995}] * 2),
    }, env="point-flagrun", common=SHORT),
    "flagrun": Group({
        "horizon": Row(90, lambda r: r.state.running is not None, True),
    }, env="point-flagrun", common={"primitive_estimate": "interval"}),
    "robot": Group({
        "control_step": Row(0.05, batches(lambda b: (b.step_s, b.body.frame_skip)), [(0.05, 5)] * 2),
    }, env="flagrun", common={**SHORT, "robot": str(ASSETS / "ant.xml")}),
}  # fmt: skip


@pytest.mark.parametrize("name", GROUPS)
def test_settings_arrive_where_they_are_used(name):
    group = GROUPS[name]
    settings = {**group.common, **{setting: row.value for setting, row in group.rows.items()}}
    having = record_generations(group.env, settings, group.generations)
    usual = record_generations(group.env, group.common, group.generations)
    expected = {each: row.expected for each, row in group.rows.items()}
    assert {each: row.place(having) for each, row in group.rows.items()} == expected
    assert [each for each, row in group.rows.items() if row.place(usual) == row.expected] == []


SHOWN = {
    *("env", "preset", "generations", "env_steps", "minutes", "algorithm"),
    *("evaluation_interval", "evaluation_episodes", "keep_checkpoints"),
    *("primitive", "freeze_primitive", "controller"),
    *("num_workers", "backend", "device", "nconmax", "njmax", "deterministic"),
    *("env_kwargs", "reset_options"),  # of external environments
    *("robot", "motors", "robot_keyframe"),
}
"""Settings that show in a run alone: see `test_train`, `test_tables`, `test_transfer`, `test_device`, tests/e2e and
`tests/envs/test_robots`."""


def test_every_setting_has_a_row():
    of_hiro = {name for section in HIRO.sections.values() for name in setting_fields(section)}  # tests/baselines
    rows = {name for group in GROUPS.values() for name in group.rows} | SHOWN
    assert rows | of_hiro == known_settings().keys() - {"max_diverged_generations"}  # which is fixed


def test_training_and_evaluations_share_no_episode(tmp_path):
    # An evaluation after generation 1 has the key of the second generation of training: only the purpose differs.
    with recording() as record:
        path = runs.train_tiny(tmp_path / "run", generations=3, evaluation_interval=1)
    with recording() as final:
        shes.evaluate(path, checkpoint="last", episodes=3, num_workers=1)
    seeds = [{*record.seeds("training")}, {*record.seeds("evaluation")}, {*final.seeds("evaluation")}]
    assert [len(each) for each in seeds] == [6, 9, 3]
    assert len(set.union(*seeds)) == 18
