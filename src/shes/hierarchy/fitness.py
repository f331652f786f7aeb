"""Shaped fitness of the members at each level. Source: SHES paper II-A (rewards are not shared between levels)."""

from __future__ import annotations

from collections.abc import Sequence

from shes.es.level import UpdateRule, select_fitness
from shes.es.perturbation import Signs
from shes.hierarchy.results import PopulationResults
from shes.types import F64Array


def shaped_fitness(results: PopulationResults, signs: Signs, rules: Sequence[UpdateRule]) -> list[F64Array]:
    """Return for each level the shaped fitness [n'] of the members that perturb it, by its own rule.

    `signs` [G, M, L] are those of every member at each level.
    """
    shaped: list[F64Array] = []
    for level, rule in enumerate(rules):
        own = signs[:, :, level]
        values = select_fitness(results.fitness[level], own)
        if len(values):
            values = rule.shaping(values)
            if rule.fall_price:
                falls = select_fitness(results.has_fallen.mean(axis=1), own)
                values = values - rule.fall_price * (falls - falls.mean())
        shaped.append(values)
    return shaped
