"""Compare a device with MuJoCo in C: two-sample tests on the returns of fixed policies.

Single steps in contact differ in the last digits, and walking is chaotic: episodes with the same seed diverge from each
other after a second. The distributions must agree. Every sample has its own seeds, so the samples are independent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from statistics import NormalDist
from typing import Any

import numpy as np
from scipy import stats

from shes.envs.named_environments import find_environment
from shes.envs.tasks.task import SimulatorFactory
from shes.evolution.strategies import EvolutionAlgorithm
from shes.rollout.episodes import EpisodeResults, EpisodeTask, Generation
from shes.rollout.lockstep import Rollout
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from shes.sim.simulator import CpuSimulator
from shes.streams import Purpose, stream
from shes.types import F64Array

ALPHA = 0.001
"""Significance level, to be corrected for the number of tests."""
POWER = 0.9
"""Probability of finding a shift of `detectable_shift` standard deviations."""

_POLICIES = 8  # fixed policies that play the episodes of a sample in turn
_SPREAD = 0.3  # standard deviation of their parameters: enough that some fall and some crawl
_LANES = 128
_MEASURES: dict[str, Callable[[EpisodeResults], float]] = {
    "environment return": lambda result: float(result.outcomes["environment_returns"][0]),
    "primitive return": lambda result: float(result.outcomes["returns"][0, -1]),
    "steps": lambda result: float(result.outcomes["steps"][0]),
    "distance moved": lambda result: float(np.hypot(*result.outcomes["final_position"][0])),
}


@dataclass(frozen=True, kw_only=True)
class DeviceComparison:
    """One measure of the episodes of a task, on the CPU and on a device."""

    env: str
    spec: str
    measure: str
    episodes: int
    """Episodes of each of the two samples."""
    cpu_mean: float
    device_mean: float
    cpu_std: float
    shift: float
    """Difference of the means, device minus CPU, in standard deviations of the CPU's sample."""
    p_shift: float
    """p of the difference of the means (Welch's test, two-sided)."""
    distance: float
    """Largest difference between the two empirical distribution functions."""
    p_distance: float
    """p of that distance (Kolmogorov-Smirnov test)."""


def compare_with_cpu(
    env: str, simulator: SimulatorFactory, *, spec: str = "shes", episodes: int = 1000, horizon: int = 500
) -> list[DeviceComparison]:
    """Return a comparison for each measure of `episodes` of `env` on `simulator` and as many others on the CPU.

    Args:
        env: Name of an environment of this package.
        simulator: Factory of the device's simulator.
        spec: Specification of the environment, `shes` or `hiro`.
        episodes: Episodes of each sample.
        horizon: Control steps of an episode.

    Raises:
        UnknownNameError: The environment or the specification is unknown.
    """
    on_cpu = sample(env, CpuSimulator, spec=spec, episodes=episodes, horizon=horizon, seed=0)
    on_device = sample(env, simulator, spec=spec, episodes=episodes, horizon=horizon, seed=1)
    return compare_samples(env, spec, on_cpu, on_device)


def compare_samples(
    env: str, spec: str, on_cpu: dict[str, F64Array], on_device: dict[str, F64Array]
) -> list[DeviceComparison]:
    """Return a comparison of two samples of `env` for each measure."""
    return [_compare(env, spec, measure, on_cpu[measure], on_device[measure]) for measure in on_cpu]


def sample(
    env: str, simulator: SimulatorFactory, *, spec: str, episodes: int, horizon: int, seed: int, lanes: int = _LANES
) -> dict[str, F64Array]:
    """Return each measure [episodes] of episodes of fixed policies, whose seeds are drawn from `seed`, `lanes` at once.

    The policies are random, and the same for every seed and simulator; exploration and reset noise are as in training.
    """
    config = make_config(
        env, "laptop", {"spec": spec, "hidden": (16,), "horizon": horizon, "noise_table_size": 1_000_000}
    )
    learner = build_algorithm(config)
    assert isinstance(learner, EvolutionAlgorithm)
    design, plan = learner.design, learner.plan()
    levels = learner.parameters(learner.start(config.run.seed))
    generation = Generation(levels=levels, sigma=_SPREAD, episodes_per_policy=1)
    seeds = stream(seed, Purpose.FRESH_EPISODES).integers(2**62, size=episodes).tolist()
    tasks = [
        EpisodeTask(
            member=number,
            noise_index=tuple((number % _POLICIES) * dim for dim in design.dims),
            signs=((1,) * len(levels),),
            slots=(0,),
            seeds=(seeds[number],),
            records_statistics=False,
        )
        for number in range(episodes)
    ]
    environment = find_environment(env)
    rollout = Rollout(design, lambda n: environment.make(n, plan.training, simulator), min(episodes, lanes), 1, horizon)
    left = iter(enumerate(tasks))
    table = learner.table.on(rollout.batch.xp)
    found = dict(rollout.run(lambda room: list(islice(left, room)), generation, table))
    rollout.batch.check_buffers()
    return {name: np.array([measure(found[i]) for i in range(episodes)]) for name, measure in _MEASURES.items()}


def _compare(env: str, spec: str, measure: str, cpu: F64Array, device: F64Array) -> DeviceComparison:
    std = float(cpu.std(ddof=1))
    difference = float(device.mean() - cpu.mean())
    is_constant = std == 0 == device.std(ddof=1)  # Welch's test divides by both
    p_shift = float(difference == 0)
    if not is_constant:
        of_device = device.mean(), device.std(ddof=1), len(device)
        welch: Any = stats.ttest_ind_from_stats(*of_device, cpu.mean(), std, len(cpu), equal_var=False)
        p_shift = float(welch.pvalue)
    # Ties, as among episodes that all reach the horizon, make this p too large: the test is conservative.
    found: Any = stats.ks_2samp(cpu, device, method="asymp")  # the exact one can fail, with a warning
    return DeviceComparison(
        env=env,
        spec=spec,
        measure=measure,
        episodes=len(cpu),
        cpu_mean=float(cpu.mean()),
        device_mean=float(device.mean()),
        cpu_std=std,
        shift=difference / std if std else difference,
        p_shift=p_shift,
        distance=float(found.statistic),
        p_distance=float(found.pvalue),
    )


def detectable_shift(episodes: int, tests: int = 1) -> float:
    """Return the shift of the mean, in standard deviations, that the test finds with probability `POWER`.

    Two samples of `episodes` each, two-sided at `ALPHA` over `tests` tests (Bonferroni).
    """
    normal = NormalDist()
    return (normal.inv_cdf(1 - ALPHA / tests / 2) + normal.inv_cdf(POWER)) * float(np.sqrt(2 / episodes))
