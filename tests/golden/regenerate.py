"""Writes the golden run: `python -m tests.golden.regenerate`, from the repository's root.

The golden run is three generations on point-gather, tiny. Regenerate it on purpose only, when a change is meant to
change numbers, and say "changes numbers" in the CHANGELOG.
"""

import itertools
import json
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from shes.algorithms.evolution.algorithm import Hyperparameters, evolve
from shes.algorithms.worker import RolloutWorker, WorkerPlan
from shes.backends.serial import SerialBackend
from shes.envs.registry import find_environment, make_task
from shes.envs.tasks.task_options import TaskOptions
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import Adam
from shes.es.schedules import Schedule
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.hierarchy.goals import make_goal_encoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.outputs import make_controller_output
from shes.hierarchy.rewards import make_primitive_reward
from shes.policies.mlp import MLP

GOLDEN_FILE = Path(__file__).with_name("generations.json")
GENERATIONS = 3
SEED = 14
"""A seed where no two fitnesses are nearly equal and no goal's component is nearly 0: rounding decides nothing."""


def golden_run(folder, change=0.0):
    """Run the three generations and return their numbers; the noise table goes into `folder`.

    `change` is how much, relatively, the start parameters are moved: to see what rounding or a fault would do.
    """
    task = make_task("point-gather", 1)
    encoding = make_goal_encoding("angle")
    design = HierarchicalDesign(
        controller=MLP(task.observation_size, (8,), 2),
        primitive=MLP(encoding.size + task.observation_size, (8,), task.action_size),
        controller_output=make_controller_output("vector"),
        goal_encoding=encoding,
        primitive_reward=make_primitive_reward("progress"),
        goal_distance=4.0,
        controller_interval=10,
        has_minimum_goal_distance=True,
        control_limit=task.control_limit,
    )
    table = NoiseTable.open(20_000, directory=folder)
    levels = []
    for number, (policy, size) in enumerate(zip(design.policies, design.observation_sizes, strict=True)):
        theta = policy.initial(stream(SEED, Purpose.INITIAL_PARAMETERS, number))
        theta *= 1 + np.float32(change) * np.random.default_rng(number).standard_normal(len(theta), dtype=np.float32)
        levels.append(
            LevelState(
                name=design.level_names[number],
                theta=theta,
                optimizer=Adam().start(len(theta)),
                statistics=ObservationStatistics.empty(size),
            )
        )
    plan = WorkerPlan(
        env=find_environment("point-gather"),
        training=TaskOptions(),
        evaluation=TaskOptions(evaluation=True),
        design=design,
        noise_table=table.path,
        horizon=40,
        evaluation_horizon=40,
        chunk_size=0,
    )
    settings = Hyperparameters(
        population_size=16,
        episodes_per_policy=2,
        sigma=Schedule(start=0.07),
        learning_rate=Schedule(start=0.02),
        updates=(UpdateRule(weight_decay=0.005),) * 2,
        learns=(True, True),
    )
    state = TrainState(seed=SEED, generation=0, env_steps=0, levels=tuple(levels))
    with SerialBackend(partial(RolloutWorker, plan)) as backend:
        reports = itertools.islice(evolve(state, settings, table, backend), GENERATIONS)
        return {"generations": [_numbers(report) for report in reports]}


def _numbers(report):
    """Return what is compared of one generation."""
    results = report.results
    numbers = {"env_steps": report.state.env_steps, "score": float(results.score.mean())}
    for level, fitness in zip(report.state.levels, results.fitness, strict=True):
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


def main():
    """Write the golden file."""
    with tempfile.TemporaryDirectory() as folder:
        numbers = golden_run(Path(folder))
    GOLDEN_FILE.write_text(json.dumps(numbers, indent=1) + "\n")


if __name__ == "__main__":
    main()
