"""Short runs against stored numbers: what no test of a part would notice.

A golden run is a few tiny generations on a point robot. `python -m tests.golden.test_generations NAME` writes one anew:
only if a change is meant to change numbers. Say "changes numbers" in the CHANGELOG then.
"""

import itertools
import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from shes.backends.backend import SerialBackend
from shes.evolution.algorithm import evolve
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config

WHAT_TO_DO = (
    "{place} is {value}, the golden file says {golden}. If nothing was meant to change, the last change has a fault. "
    "If they were meant to, run `python -m tests.golden.test_generations {name}`: 'changes numbers' in CHANGELOG.md."
)
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
    "branched_two_levels": ("point-push", 7, {**BRANCHED, "primitive_population_size": 40, "fall_price": 0.5}),
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
    noise = [np.random.default_rng(number).standard_normal for number in range(len(state.levels))]
    levels = tuple(
        replace(level, theta=level.theta * (1 + np.float32(change) * normal(len(level.theta), dtype=np.float32)))
        for level, normal in zip(state.levels, noise, strict=True)
    )
    settings = learner.hyperparameters
    rules = tuple(replace(rule, holds_when_tied=False) for rule in settings.updates)
    state, settings = replace(state, levels=levels), replace(settings, updates=rules)
    with SerialBackend(partial(RolloutWorker, learner.plan())) as backend:
        reports = itertools.islice(evolve(state, settings, learner.table, backend), GENERATIONS)
        return {"generations": [_numbers(report) for report in reports]}


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


def _leaves(value, place=""):
    """Yield (place, number) of everything in nested lists and dicts."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{place}[{number}]")
    else:
        yield place, value


def _compared(name, change=0.0):
    """Yield the place, the value and the golden value of every number of a run, and whether the two are close."""
    golden = dict(_leaves(json.loads(golden_file(name).read_text(encoding="utf-8"))))
    values = dict(_leaves(golden_run(name, change)))
    assert values.keys() == golden.keys(), "the golden file has other entries: write it anew"
    for place, expected in golden.items():  # another CPU rounds differently
        yield place, values[place], expected, values[place] == pytest.approx(expected, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("name", RUNS)
def test_a_short_run_gives_the_golden_numbers(name):
    """It sees a thousandth. Ten times the rounding of a float32 must not show: else choose another seed."""
    compared = list(_compared(name))
    assert len(compared) > 25 * GENERATIONS
    for place, value, golden, is_close in compared:
        assert is_close, WHAT_TO_DO.format(place=place, value=value, golden=golden, name=name)
    assert [place for place, *_, is_close in _compared(name, change=1e-6) if not is_close] == []
    assert sum(not is_close for *_, is_close in _compared(name, change=1e-3)) > 20


if __name__ == "__main__":
    for each in sys.argv[1:]:
        golden_file(each).write_text(json.dumps(golden_run(each), indent=1) + "\n")
