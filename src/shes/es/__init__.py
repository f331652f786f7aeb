"""Evolution strategies on plain vectors. `EvolutionStrategy` can be used on its own."""

from shes.es.strategy import EvolutionStrategy

__all__ = ["EvolutionStrategy"]
