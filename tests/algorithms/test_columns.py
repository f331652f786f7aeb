"""What the tables say of a generation of an evolution strategy, and of runs, computed once more by other means."""

import math
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import rankdata

from shes.algorithms.evolution.algorithm import GenerationReport, evolve
from shes.algorithms.evolution.columns import columns
from shes.algorithms.evolution.populations import Population, generation_work
from shes.algorithms.worker import RolloutWorker
from shes.backends.serial import SerialBackend
from shes.es.level import LevelState, LevelUpdate, TrainState, UpdateRule
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import Generation
from shes.hierarchy.population_tasks import Work
from shes.hierarchy.results import PopulationResults
from shes.runs.build import build_algorithm
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from tests.e2e import runs


def report(noise_index, signs=None):
    """A generation of two members with two episodes each; the last episode diverged."""
    results = PopulationResults.empty(2, 2, 2)
    results.returns[:] = [[[1, 3], [5, 7]], [[-1, -3], [0, 0]]]
    results.score[:] = [[0, 1], [2, 3]]
    results.success[:] = [[False, True], [True, True]]
    results.steps[:] = [[10, 20], [30, 40]]
    results.has_terminated[:] = [[True, False], [False, False]]
    results.has_diverged[:] = [[False, False], [False, True]]
    results.goals_reached[:] = [[0, 1], [3, 1]]
    results.seconds[:] = [3.00004, 2, 1.5]
    levels = (level("controller", [3, 4]), level("primitive", [0, 0, 0, 0, 0]))
    updates = (
        LevelUpdate(level=levels[0], gradient_norm=0.25, halves_cosine=-0.5, update_ratio=0.125),
        LevelUpdate(level=levels[1]),
    )
    generation = Generation(levels=(), sigma=0.0625, episodes_per_policy=2, is_evaluation=False)
    work = Work(
        signs=np.ones((2, 1, 2), np.int8) if signs is None else signs,
        noise_index=np.array(noise_index),
        tasks=[],
        generation=generation,
    )
    return GenerationReport(
        state=TrainState(seed=0, generation=9, env_steps=1000, levels=levels),
        population=Population(
            work=work, results=results, rules=(UpdateRule(),) * 2, learns=(True, True), learning_rate=0.03125
        ),
        branches=None,
        updates=updates,
        rollout_s=1.25,
        update_s=0.5,
    )


def level(name, theta):
    start = Adam().start(len(theta))
    return LevelState(
        name=name, theta=np.array(theta, np.float32), optimizer=start, statistics=ObservationStatistics.empty(1)
    )


def test_a_row_holds_what_the_generation_saw():
    row = columns(report([[2, 2], [0, 4]]))
    nothing = {name for name, value in row.items() if math.isnan(value)}
    assert nothing == {f"primitive_{name}" for name in ("gradient_norm", "halves_cosine", "update_ratio")}
    assert {name: value for name, value in row.items() if name not in nothing} == {
        "controller_return_mean": 2.5,  # of the members' means: 2, and 3 because 7, diverged, counts as the worst, 1
        "controller_return_max": 3.0,
        "primitive_return_mean": -1.75,  # 0, diverged, counts as -3
        "primitive_return_max": -1.5,
        "score_mean": 1.5,
        "success_rate": 0.75,
        "episode_steps_mean": 25.0,
        "terminated_rate": 0.25,
        "diverged_rate": 0.25,
        "diverged_episodes": 1,
        "episodes_per_policy": 2,
        "sigma": 0.0625,
        "learning_rate": 0.03125,
        "goals_reached_mean": 1.25,
        "controller_noise_distinct": 1,
        "controller_noise_overlapping": 2,  # twice the same place
        "controller_rank_ties": 0.0,
        "controller_gradient_norm": 0.25,
        "controller_halves_cosine": -0.5,
        "controller_update_ratio": 0.125,
        "controller_theta_norm": 5.0,
        "primitive_noise_distinct": 2,
        "primitive_noise_overlapping": 2,  # 0 and 4 share a normal in vectors of 5
        "primitive_rank_ties": 0.0,
        "primitive_theta_norm": 0.0,
        "rollout_s": 1.25,
        "update_s": 0.5,
        "physics_s": 3.0,
        "policy_s": 2.0,
        "task_s": 1.5,
    }


@pytest.mark.parametrize(
    ("returns", "share"),
    [
        ([1, 2, 3, 4], 0.0),
        ([1, 1, 1, 1], 1.0),
        ([1, 2, 1, 4], 0.5),
        ([2, 2, 7, 7], 1.0),
        ([0.0, -0.0, 3, 4], 0.5),
        ([1, 1, 1, 4], 0.75),
    ],
)
def test_rank_ties_are_the_share_of_members_whose_fitness_another_one_has(returns, share):
    made = report([[0], [0]], signs=np.ones((1, 4, 2), np.int8))
    results = PopulationResults.empty(2, 4, 1)
    results.returns[0, :, 0] = returns
    row = columns(replace(made, population=replace(made.population, results=results)))
    assert (row["controller_rank_ties"], row["primitive_rank_ties"]) == (share, 1.0)


def test_a_level_that_only_some_members_perturb_has_noise_and_ties_of_these_alone():
    signs = np.zeros((4, 1, 2), np.int8)
    signs[:2, :, 0] = 1  # half of the members perturb the controller, nobody the primitive
    made = report([[0, 9, 9, 9], [7, 7, 7, 7]], signs=signs)
    results = PopulationResults.empty(2, 4, 1)
    results.returns[0, :, 0] = [1, 2, 2, 2]
    row = columns(replace(made, population=replace(made.population, results=results)))
    assert (row["controller_noise_distinct"], row["controller_rank_ties"]) == (2, 0.0)
    assert (row["primitive_noise_distinct"], row["primitive_noise_overlapping"]) == (0, 0)
    assert math.isnan(row["primitive_rank_ties"])


def test_the_numbers_of_a_primitive_on_branches_are_those_of_its_pairs():
    """The returns, ties and noise of its level, and columns of their own; the other columns are whole episodes'."""
    plain = report([[2, 2], [0, 4]])
    results = PopulationResults.empty(1, 4, 1)
    results.returns[0, :, 0] = [1, 2, 2, 9]
    results.steps[:, 0] = [50, 50, 50, 30]
    results.has_terminated[3] = True
    results.seconds[:] = [1, 0.5, 0.25]
    generation = Generation(levels=(), sigma=0.3, episodes_per_policy=1, is_evaluation=False, branch_steps=50)
    work = Work(
        signs=np.array([[[1], [-1]]] * 2, np.int8), noise_index=np.array([[6, 8]]), tasks=[], generation=generation
    )
    pairs = Population(work=work, results=results, rules=(UpdateRule(),), learns=(True,), learning_rate=0.07)
    before, row = (columns(made) for made in (plain, replace(plain, branches=pairs)))
    changed = {name: value for name, value in row.items() if repr(value) != repr(before.get(name))}
    assert changed == {
        "primitive_return_mean": 3.5,
        "primitive_return_max": 9.0,
        "primitive_rank_ties": 0.5,
        "branch_steps_mean": 45.0,
        "branch_terminated_rate": 0.25,
        "primitive_sigma": 0.3,
        "primitive_learning_rate": 0.07,
        "physics_s": 4.0,
        "policy_s": 2.5,
        "task_s": 1.75,
    }


# The columns of real runs, computed once more by other means.


def generation_by_hand(path, config, number):
    """Return the state before generation `number` of a run, its signs [G, M, L] and its noise [L, G]."""
    state = runs.state(path, number - 1)
    work = generation_work(state, build_algorithm(config).hyperparameters, config.evolution.noise_table_size)
    return state, work.signs, work.noise_index


@pytest.fixture(scope="module")
def every_generation(tmp_path_factory):
    """A run that keeps every checkpoint, with plain SGD: its step is the learning rate times the gradient.

    Its rewards are dense: of a sparse one, half a population may have no gradient at all.
    """
    path = tmp_path_factory.mktemp("every") / "run"
    changing = {
        "sigma_schedule": "linear",
        "sigma_end": 0.2,
        "learning_rate_schedule": "exponential",
        "learning_rate_end": 0.001,
    }
    plain = {"optimizer": "sgd", "momentum": 0.0, "weight_decay": 0.0, "population_size": 16, "sigma": 0.1}
    return runs.train_tiny(path, "point-maze", keep_checkpoints=1, schedule_generations=2, **plain, **changing)


def test_gradient_and_update_columns_are_what_the_checkpoints_say(every_generation):
    table = read_csv(every_generation / "progress.csv")
    for generation in (1, 2, 3, 4):
        before, after = (runs.state(every_generation, number).levels for number in (generation - 1, generation))
        rate = table["learning_rate"][generation - 1]
        for old, new in zip(before, after, strict=True):
            step = new.theta.astype(np.float64) - old.theta
            assert table[f"{old.name}_gradient_norm"][generation - 1] == pytest.approx(
                np.linalg.norm(new.optimizer.slots["velocity"].astype(np.float64)), rel=1e-5
            )
            assert table[f"{old.name}_gradient_norm"][generation - 1] == pytest.approx(
                np.linalg.norm(step) / rate, rel=1e-3
            )
            assert table[f"{old.name}_update_ratio"][generation - 1] == pytest.approx(
                np.linalg.norm(step) / np.linalg.norm(old.theta.astype(np.float64)), rel=1e-3
            )
            assert table[f"{old.name}_theta_norm"][generation - 1] == pytest.approx(np.linalg.norm(new.theta), rel=1e-6)


def test_schedules_are_in_the_table(every_generation):
    table = read_csv(every_generation / "progress.csv")
    np.testing.assert_allclose(table["sigma"], [0.1, 0.15, 0.2, 0.2])
    np.testing.assert_allclose(table["learning_rate"], [0.01, math.sqrt(0.01 * 0.001), 0.001, 0.001])
    assert table["episodes_per_policy"] == [1, 1, 1, 1]


def test_the_cosine_is_that_of_the_gradients_of_two_half_populations(every_generation):
    folder, table = RunFolder.open(every_generation), read_csv(every_generation / "progress.csv")
    config = folder.read_config()
    seen = {}

    class Listening(SerialBackend):
        def map(self, tasks):
            for task, result in zip(tasks, super().map(tasks), strict=True):
                for slot, returns in zip(task.slots, result.returns.T, strict=True):  # one episode a member
                    seen[task.member + slot] = returns
                yield result

    learner = build_algorithm(config)
    noise = learner.table
    for generation in (1, 3):
        state, signs, noise_index = generation_by_hand(every_generation, config, generation)
        with Listening(partial(RolloutWorker, learner.plan())) as backend:
            next(evolve(state, learner.hyperparameters, noise, backend))
        fitness = np.array([seen[member] for member in range(16)]).T
        groups, members, _ = signs.shape
        for i, level in enumerate(state.levels):
            ranks = rankdata(fitness[i]) / 15
            estimates = np.zeros((2, len(level.theta)))
            for group in range(groups):
                vector = noise.slice(int(noise_index[i, group]), len(level.theta))
                weight = sum(ranks[group * members + m] * signs[group, m, i] for m in range(members))
                estimates[group // (groups // 2)] += weight * vector.astype(np.float64)
            expected = estimates[0] @ estimates[1] / np.linalg.norm(estimates[0]) / np.linalg.norm(estimates[1])
            assert table[f"{level.name}_halves_cosine"][generation - 1] == pytest.approx(expected, abs=1e-4)
            counts = Counter(fitness[i].tolist())
            tied = sum(count for count in counts.values() if count > 1) / 16
            assert table[f"{level.name}_rank_ties"][generation - 1] == tied


def test_the_parts_of_a_rollout_add_up_to_it(tmp_path):
    """In this process there is one worker: its parts are no more than the time of the roll-out, and most of it."""
    table = read_csv(runs.train_tiny(tmp_path / "run", horizon=200, evaluation_horizon=5) / "progress.csv")
    parts = sum(np.array(table[f"{name}_s"]) for name in ("physics", "policy", "task"))
    assert all(min(table[f"{name}_s"]) > 0 for name in ("physics", "policy", "task"))
    rollout = np.array(table["rollout_s"])
    assert (parts <= rollout + 1e-3).all()
    assert (parts[1:] >= 0.6 * rollout[1:]).all()  # the first one builds the environments


ONE_LEVEL = [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {}, "primitive")]


@pytest.mark.parametrize(("env", "settings", "name"), ONE_LEVEL)
def test_a_run_of_one_level_has_the_columns_of_that_level_alone(tmp_path, env, settings, name):
    table = read_csv(runs.train_tiny(tmp_path / "run", env, generations=2, **settings) / "progress.csv")
    others = {"controller", "primitive", "policy"} - {name}
    assert {f"{name}_return_mean", f"{name}_halves_cosine", f"{name}_rank_ties", f"{name}_theta_norm"} <= set(table)
    assert not [
        column for column in table if column.startswith(tuple(f"{other}_" for other in others)) and column != "policy_s"
    ]
    assert ("goals_reached_mean" in table) is (name == "primitive")
    assert all(len(column) == 2 for column in table.values())


def test_goals_are_counted_once_each_time_they_are_reached(tmp_path):
    """Goals lie where the robot can be within a step: as many are reached as set, and no more."""
    near = {"goal_distance": 0.1, "minimum_goal_distance": False, "controller_interval": 5}
    table = read_csv(runs.train_tiny(tmp_path / "run", **near) / "progress.csv")
    assert table["goals_reached_mean"] == [4, 4, 4, 4]  # in 20 steps
    far = read_csv(runs.train_tiny(tmp_path / "far", goal_distance=1000.0) / "progress.csv")
    assert far["goals_reached_mean"] == [0, 0, 0, 0]
