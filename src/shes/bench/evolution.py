"""The parts of Algorithm 1 that the benchmarks measure: rollouts and update.

This is the only module outside `algorithms` that uses an algorithm by more than its contract.
"""

from __future__ import annotations

from shes.algorithms.evolution.algorithm import GenerationReport, evolve
from shes.algorithms.evolution.populations import Hyperparameters, Population, generation_work
from shes.algorithms.evolution.strategies import EvolutionAlgorithm
from shes.algorithms.registry import ALGORITHMS
from shes.errors import ConfigError
from shes.runs.build import build_algorithm
from shes.runs.config import TrainConfig
from shes.runs.device import check_limits

__all__ = ["EvolutionAlgorithm", "GenerationReport", "Hyperparameters", "Population", "evolution_strategy", "evolve"]
__all__ += ["generation_work"]


def evolution_strategy(config: TrainConfig) -> EvolutionAlgorithm:
    """Return the evolution strategy of `config`; raise ConfigError if there is none, or too little memory."""
    algorithm = build_algorithm(config)
    if not isinstance(algorithm, EvolutionAlgorithm):
        known = [name for name, cls in ALGORITHMS.items() if issubclass(cls, EvolutionAlgorithm)]
        raise ConfigError(
            f"bench measures evolution strategies, got {config.run.algorithm}. Set --algorithm {' or '.join(known)}."
        )
    check_limits(config, algorithm.design)
    return algorithm
