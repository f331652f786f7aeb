"""What the tables say of a generation of an evolution strategy, and of runs, computed once more by other means."""

import math

import numpy as np
import pytest

from shes.es.level import LevelState, LevelUpdate
from shes.es.optimizers import Adam
from shes.evolution.algorithm import GenerationReport, sources_of_fitness
from shes.evolution.estimates import Population
from shes.evolution.state import TrainState
from shes.evolution.strategies import columns
from shes.rollout.episodes import PARTS, Generation, empty_outcomes
from shes.rollout.roll_out import PopulationResults
from shes.runs.tables import read_csv
from tests.e2e import runs


def population(returns, noise_index, signs=None, levels=(0, 1), rate=0.03125, **outcomes):
    """Return a population with these `returns` [L, n, E] and other quantities [n, E]."""
    results = PopulationResults(outcomes=empty_outcomes(len(returns), *np.shape(returns)[1:]))
    results.returns[:] = returns
    for name, values in outcomes.items():
        results.outcomes[name] = values
    episodes = results.outcomes.shape[1]
    generation = Generation(levels=(), sigma=2 * rate, episodes_per_policy=episodes)
    signs = np.ones((len(noise_index[0]), 1, len(levels))) if signs is None else signs
    return Population(levels=levels, signs=np.array(signs, np.int8), noise_index=np.array(noise_index), tasks=[],
                      generation=generation, learning_rate=rate, results=results)  # fmt: skip


def row_of(*populations):
    thetas = {"controller": [3, 4], "primitive": [0, 0, 0, 0, 0]}
    levels = tuple(LevelState.start(name, np.array(theta, np.float32), Adam(), 1) for name, theta in thetas.items())
    updates = (
        LevelUpdate(level=levels[0], gradient_norm=0.25, halves_cosine=-0.5, update_ratio=0.125),
        LevelUpdate(level=levels[1]),
    )
    state = TrainState(seed=0, generation=9, env_steps=1000, levels=levels)
    report = GenerationReport(state=state, populations=populations, sources=sources_of_fitness(populations),
                              updates=updates, rollout_s=1.25, update_s=0.5)  # fmt: skip
    return columns(report)


WHOLE = population(
    [[[1, 3], [5, 7]], [[-1, -3], [0, 0]]],
    [[2, 2], [0, 4]],
    score=[[0, 1], [2, 3]],
    success=[[False, True], [True, True]],
    steps=[[10, 20], [30, 40]],
    has_terminated=[[True, False], [False, False]],
    has_diverged=[[False, False], [False, True]],
    goals_reached=[[0, 1], [3, 1]],
)
WHOLE.results.seconds[:] = [3.00004, 2, 1.5]


def test_a_row_holds_what_the_generation_saw():
    row = row_of(WHOLE)
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


def test_a_primitive_on_branches_has_the_numbers_of_its_pairs():
    """The returns, ties and noise of its level, and columns of their own; the other columns are whole episodes'."""
    pairs = population([[[1], [2], [2], [9]]], [[6, 8]], [[[1], [-1]]] * 2, (1,), 0.07,
                       steps=[[50], [50], [50], [30]], has_terminated=[[False]] * 3 + [[True]])  # fmt: skip
    pairs.results.seconds[:] = [1, 0.5, 0.25]
    before, row = row_of(WHOLE), row_of(WHOLE, pairs)
    assert {name: value for name, value in row.items() if repr(value) != repr(before.get(name))} == {
        "primitive_return_mean": 3.5,
        "primitive_return_max": 9.0,
        "primitive_rank_ties": 0.5,
        "branch_steps_mean": 45.0,
        "branch_terminated_rate": 0.25,
        "primitive_sigma": 0.14,
        "primitive_learning_rate": 0.07,
        "physics_s": 4.0,
        "policy_s": 2.5,
        "task_s": 1.75,
    }


@pytest.mark.parametrize(("returns", "share"), [([1, 2, 1, 4], 0.5), ([2, 2, 7, 7], 1.0), ([0.0, -0.0, 3, 4], 0.5)])
def test_ties_and_noise_are_those_of_the_members_that_perturb(returns, share):
    returns = np.array([returns, [0] * 4])[:, :, None]
    row = row_of(population(returns, [[0] * 4, [0, 5, 10, 14]]))
    assert (row["controller_rank_ties"], row["primitive_rank_ties"]) == (share, 1.0)
    assert row["primitive_noise_overlapping"] == 2  # those that start at 10 and 14: vectors have 5 normals
    signs = np.array([[[1, 0]], [[1, 0]], [[0, 0]], [[0, 0]]])  # half of them the controller, nobody the primitive
    row = row_of(population(returns, [[0, 9, 9, 9], [7, 7, 7, 7]], signs))
    assert (row["controller_noise_distinct"], row["controller_rank_ties"]) == (2, float(np.ptp(returns[0, :2]) == 0))
    assert (row["primitive_noise_distinct"], row["primitive_noise_overlapping"]) == (0, 0)
    assert math.isnan(row["primitive_rank_ties"])


@pytest.mark.parametrize(
    ("env", "settings", "name"), [("point-gather", {"algorithm": "es"}, "policy"), ("point-flagrun", {}, "primitive")]
)
def test_a_run_of_one_level_has_the_columns_of_that_level_alone(tmp_path, env, settings, name):
    table = read_csv(runs.train_tiny(tmp_path / "run", env, generations=1, **settings) / "progress.csv")
    others = tuple(f"{other}_" for other in {"controller", "primitive", "policy"} - {name})
    assert {f"{name}_return_mean", f"{name}_halves_cosine", f"{name}_rank_ties", f"{name}_theta_norm"} <= set(table)
    assert not [column for column in table if column.startswith(others) and column != "policy_s"]
    assert ("goals_reached_mean" in table) is (name == "primitive")
    parts = [table[f"{part}_s"][0] for part in PARTS]  # of one worker in this process
    assert 0 < sum(parts) <= table["rollout_s"][0] + 0.001  # rounded to 0.0001 each
