"""`evolve` with every option on a point robot: the same bits on any workers, and from any generation on."""

import itertools
from functools import lru_cache, partial

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.backends.processes import ProcessesBackend
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import MIRRORINGS, PERTURBATIONS
from shes.es.shaping import FITNESS_SHAPINGS
from shes.evolution.algorithm import evolve
from shes.evolution.estimates import COMMON_RANDOM_NUMBERS
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.rollout.formula import bits

GENERATIONS = 3
COMMON = {"population_size": 8, "horizon": 12, "hidden": (8,), "noise_table_size": 50_000}
SCHEDULES = {"sigma_end": 0.01, "learning_rate_end": 0.001, "schedule_generations": 2}
BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric", "sigma": 0.1}
CHOICES = {
    "fitness_shaping": FITNESS_SHAPINGS,
    "optimizer": OPTIMIZERS,
    "perturbation": PERTURBATIONS,
    "mirrored": MIRRORINGS,
    "common_random_numbers": COMMON_RANDOM_NUMBERS,
}
OPTIONS = {
    **{f"{name}={each}": {name: each} for name, choices in CHOICES.items() for each in choices},
    "fitness_shaping=pair_rank": {"fitness_shaping": "pair_rank", "mirrored": "pair"},
    "schedules": SCHEDULES,
    "three episodes": {"episodes_per_policy": 3},
    "some statistics": {"statistics_fraction": 0.5},
    "no statistics": {"statistics_fraction": 0.0},
    "one hot, clock": {"controller_output": "one_hot", "goal_encoding": "vector", "primitive_reward": "cosine",
                       "clock_frequency": 1.3},
    "everything": {"episodes_per_policy": 3, "optimizer": "sgd", "perturbation": "one_to_many", **SCHEDULES,
                   "common_random_numbers": "population", "statistics_fraction": 0.5, "hidden": (6,)},
}  # fmt: skip
ONE_LEVEL = {
    "plain": {},
    "own episodes": {"mirrored": "none", "common_random_numbers": "off"},
    "schedules": SCHEDULES,
}
CASES = {
    **{name: ("point-maze", settings) for name, settings in OPTIONS.items()},
    **{f"alone, {name}": ("point-flagrun", {"hidden": (9,), **settings}) for name, settings in ONE_LEVEL.items()},
    **{f"flat, {name}": ("point-maze", {"hidden": (10,), "algorithm": "es", "clock_frequency": 1.3, **settings})
       for name, settings in ONE_LEVEL.items()},
    "branches": ("point-push", {"hidden": (7,), "primitive_population_size": 12, "fall_price": 0.5, **BRANCHES}),
    "running": ("point-flagrun", {"hidden": (12,), "population_size": 12, "horizon": 16, **BRANCHES}),
}  # fmt: skip
"""The episodes of the last one are over after the second generation."""


@lru_cache
def learner(case, chunk_size=1):
    """Return the learner of a case, whose workers run so many members at a time."""
    env, settings = CASES[case]
    goals = {} if "algorithm" in settings else {"controller_interval": 4}
    episodes = {} if case == "running" else {"episodes_per_policy": 2}
    options = {**COMMON, **goals, **episodes, **settings, "chunk_size": chunk_size}
    return build_algorithm(make_config(env, "smoke", options))


def run(case, backend, state=None, generations=GENERATIONS):
    made = learner(case)
    return list(
        itertools.islice(evolve(state or made.start(3), made.hyperparameters, made.table, backend), generations)
    )


@lru_cache
def expected(case):
    """Return the run of a case on one worker, a member at a time."""
    with SerialBackend(partial(RolloutWorker, learner(case).plan())) as backend:
        return run(case, backend)


@pytest.mark.parametrize("case", ["running", pytest.param("three episodes", marks=pytest.mark.extras)])
def test_worker_processes_change_no_bit(case):
    """More cases are in `e2e/test_same_numbers.py`."""
    with ProcessesBackend(partial(RolloutWorker, learner(case, 3).plan()), 3) as backend:
        assert bits(run(case, backend)) == bits(expected(case))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("stop", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_goes_on_on_other_workers_as_if_it_had_not_stopped(case, stop):
    """The other workers are three, whose share is cut as for processes, with up to five members at a time."""
    whole, before = expected(case), learner(case).start(3)
    for old, new in zip(before.levels, whole[-1].state.levels, strict=True):
        assert not np.array_equal(old.theta, new.theta)  # otherwise the comparison would say nothing
    if case == "running":
        assert [report.state.running is None for report in whole] == [False, True, False]
    with SerialBackend(partial(RolloutWorker, learner(case, 5).plan())) as backend:
        backend.num_workers = 3
        rest = run(case, backend, whole[stop - 1].state, GENERATIONS - stop)
    assert bits(rest) == bits(whole[stop:])
