"""Evolution strategies: numbers in, numbers out. Usable alone through `EvolutionStrategy`."""

from shes.es.strategy import EvolutionStrategy

__all__ = ["EvolutionStrategy"]
