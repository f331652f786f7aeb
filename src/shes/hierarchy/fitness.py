"""Shaped fitness of the members at each level, and for the first level the novelty blended with it.

Source: SHES paper II-A (rewards are not shared between levels); Conti et al. 2018 (novelty).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from shes.es.level import UpdateRule, select_fitness
from shes.es.novelty import NoveltyState, WeightRule, blend, extend, novelty
from shes.es.perturbation import Signs
from shes.hierarchy.results import PopulationResults, lower_diverged
from shes.types import F64Array


def advance_novelty(
    state: NoveltyState | None, rule: WeightRule | None, results: PopulationResults, member: int
) -> NoveltyState | None:
    """Return the novelty state after the mean policies were run as member number `member`.

    Their final positions enter the archive before the population is measured by it, except those of diverged episodes.
    """
    if state is None or rule is None:
        return None
    returns = lower_diverged(results.environment_returns, results.has_diverged)
    mean_return, population_return = float(returns[member].mean()), float(returns[:member].mean())
    weight, best_return, stalled = rule.next(state, mean_return, population_return)
    state = replace(state, weight=weight, best_return=best_return, stalled=stalled)
    return extend(state, results.final_position[member][~results.has_diverged[member]])


def shaped_fitness(
    results: PopulationResults,
    signs: Signs,
    rules: Sequence[UpdateRule],
    search: NoveltyState | None,
    neighbours: int,
) -> list[F64Array]:
    """Return for each level the shaped fitness [n'] of the members that perturb it, by its own rule.

    `signs` [G, M, L] are those of every member at each level. With a novelty search, the fitness of the first level
    is blended with the mean distance to the nearest `neighbours` in the archive.
    """
    shaped: list[F64Array] = []
    for level, rule in enumerate(rules):
        own = signs[:, :, level]
        values = select_fitness(results.fitness[level], own)
        if len(values):
            values = rule.shaping(values)
            if level == 0 and search is not None:
                novel = novelty(results.final_position, search.archive, neighbours)
                novel[results.has_diverged.any(axis=1)] = 0  # final positions of diverged episodes are meaningless
                values = blend(values, rule.shaping(select_fitness(novel, own)), search.weight)
            if rule.fall_price:
                falls = select_fitness(results.has_fallen.mean(axis=1), own)
                values = values - rule.fall_price * (falls - falls.mean())
        shaped.append(values)
    return shaped
