"""What a member's episodes are worth to each level: shaped returns, and for the first level novelty beside them.

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

__all__ = ["advance_novelty", "shaped_fitness"]


def advance_novelty(
    state: NoveltyState | None, rule: WeightRule | None, results: PopulationResults, member: int
) -> NoveltyState | None:
    """Return the search for novelty with what the mean policies, run as member number `member`, came to.

    The archive knows them before the population is measured by it, but for those that diverged.
    """
    if state is None or rule is None:
        return None
    returns = lower_diverged(results.environment_returns, results.has_diverged)
    mean_return, population_return = float(returns[member].mean()), float(returns[:member].mean())
    weight, best_return, stalled = rule.next(state, mean_return, population_return)
    ahead = replace(state, weight=weight, best_return=best_return, stalled=stalled)
    return extend(ahead, results.final_position[member][~results.has_diverged[member]])


def shaped_fitness(
    results: PopulationResults,
    signs: Signs,
    rules: Sequence[UpdateRule],
    search: NoveltyState | None,
    neighbours: int,
) -> list[F64Array]:
    """Return for each level the shaped fitness [n'] of the members that perturb it.

    Args:
        results: What came of the population.
        signs: Signs of every member at each level [G, M, L].
        rules: How each level shapes fitness.
        search: Archive and weight of the search for novelty, if there is one.
        neighbours: Nearest places of the archive that count.
    """
    shaped: list[F64Array] = []
    for level, rule in enumerate(rules):
        fitness = select_fitness(results.fitness[level], signs[:, :, level])
        if not len(fitness):
            shaped.append(fitness)
            continue
        worth = rule.shaping(fitness)
        if level == 0 and search is not None:
            novel = novelty(results.final_position, search.archive, neighbours)
            novel[results.has_diverged.any(axis=1)] = 0  # where blown-up physics ends says nothing
            worth = blend(worth, rule.shaping(select_fitness(novel, signs[:, :, level])), search.weight)
        if rule.fall_price:
            falls = select_fitness(results.has_fallen.mean(axis=1), signs[:, :, level])
            worth = worth - rule.fall_price * (falls - falls.mean())
        shaped.append(worth)
    return shaped
