"""Writes the golden runs: `python -m tests.golden.regenerate NAME`, from the repository's root.

A golden run is a few tiny generations on a point robot. Regenerate one on purpose only, when a change is meant to
change numbers, and say "changes numbers" in the CHANGELOG.
"""

import itertools
import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from shes.backends.backend import SerialBackend
from shes.evolution.algorithm import evolve
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config

EVERY = {
    "hidden": (8,),
    "horizon": 40,
    "population_size": 16,
    "sigma": 0.07,
    "learning_rate": 0.02,
    "weight_decay": 0.005,
    "controller_interval": 10,
    "noise_table_size": 20_000,
}
BRANCHED = {
    **EVERY,
    "primitive_estimate": "interval",
    "primitive_view": "egocentric",
    "primitive_reward": "metres",
    "goal_encoding": "angle_metres",
    "clock_frequency": 1.3,
    "intervals": 2,
}
RUNS = {
    "generations": ("point-gather", 14, {**EVERY, "episodes_per_policy": 2}),
    "branched_two_levels": ("point-push", 7, {**BRANCHED, "primitive_population_size": 12, "fall_price": 0.5}),
    "branched_one_level": ("point-flagrun", 3, BRANCHED),
}
"""Environment, seed and settings of each run.

With these seeds no two fitnesses are nearly equal and no goal's component is nearly 0: rounding decides nothing.
"""
GENERATIONS = 3


def golden_file(name):
    """Return the file of a golden run."""
    return Path(__file__).with_name(f"{name}.json")


def golden_run(name, change=0.0):
    """Run the three generations and return their numbers.

    `change` is how much, relatively, the start parameters are moved: to see what rounding or a fault would do.
    """
    env, seed, settings = RUNS[name]
    learner = build_algorithm(make_config(env, "smoke", settings))
    state = learner.start(seed)
    levels = tuple(
        replace(level, theta=level.theta * (1 + np.float32(change) * _normal(number, len(level.theta))))
        for number, level in enumerate(state.levels)
    )
    settings = learner.hyperparameters
    rules = tuple(replace(rule, holds_when_tied=False) for rule in settings.updates)
    state, settings = replace(state, levels=levels), replace(settings, updates=rules)
    with SerialBackend(partial(RolloutWorker, learner.plan())) as backend:
        reports = itertools.islice(evolve(state, settings, learner.table, backend), GENERATIONS)
        return {"generations": [_numbers(report) for report in reports]}


def _normal(seed, size):
    return np.random.default_rng(seed).standard_normal(size, dtype=np.float32)


def _numbers(report):
    """Return what is compared of one generation."""
    numbers = {"env_steps": report.state.env_steps, "score": float(report.populations[0].results.score.mean())}
    for level, (population, i) in zip(report.state.levels, report.sources, strict=True):
        fitness = population.results.fitness[i]
        numbers[level.name] = {
            "fitness_mean": float(fitness.mean()),
            "fitness_std": float(fitness.std()),
            "theta_norm": float(np.linalg.norm(level.theta.astype(float))),
            "theta_first": level.theta[:6].astype(float).round(9).tolist(),
            "theta_last": level.theta[-4:].astype(float).round(9).tolist(),
            "observations": level.statistics.count,
            "observation_mean": level.statistics.mean.round(9).tolist(),
            "observation_std": level.statistics.std.round(9).tolist(),
        }
    return numbers


if __name__ == "__main__":
    for each in sys.argv[1:]:
        golden_file(each).write_text(json.dumps(golden_run(each), indent=1) + "\n")
