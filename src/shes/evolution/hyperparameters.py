"""From the settings of a run to the hyperparameters of Algorithm 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from shes.algorithms.problem import Problem
from shes.es.level import UpdateRule
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import FITNESS_SHAPINGS, PairRanks
from shes.evolution.archive import Archive
from shes.evolution.estimates import Hyperparameters, IntervalEstimate, Schedule
from shes.evolution.evolution_settings import HierarchySettings
from shes.evolution.way_search import SLICES, WaySearch
from shes.options import make


def learns(settings: Any) -> tuple[bool, ...]:
    """Return whether each level learns."""
    is_frozen = settings.values.get("primitive") is not None and settings.values.get("freeze_primitive", False)
    return tuple(not (is_frozen and name == "primitive") for name in settings.level_names)


def is_alone(settings: Any) -> bool:
    """Return whether there is only a primitive, because the environment sets the goals."""
    return settings.level_names == ("primitive",)


def is_branched(settings: Any) -> bool:
    """Return whether the primitive is evaluated by branched intervals, even if it does not learn."""
    return "estimate" in settings and settings.estimate.primitive_estimate == "interval"


def explores(settings: Any) -> bool:
    """Return whether the run searches for a way to the target."""
    return "exploration" in settings and settings.exploration.explore == "archive"


def by_episodes(settings: Any) -> tuple[bool, ...]:
    """Return whether each level's mirrored groups are whole episodes: also those of a primitive that learns alone."""
    has_branches = is_branched(settings) and not is_alone(settings)
    return (*learns(settings)[:-1], False) if has_branches else learns(settings)


def population(settings: Any) -> tuple[int, int]:
    """Return the number of policies in a generation, those in branches included, and the most episodes of each."""
    branches = settings.values.get("primitive_population_size") or 0
    return settings.evolution.population_size + branches, settings.evolution.episodes_per_policy


def steps_per_generation(settings: Any) -> int:
    """Return the environment steps of a generation if no episode and no branch ends early."""
    evolution = settings.evolution
    episodes = evolution.population_size * evolution.episodes_per_policy * settings.episodes.horizon
    if not is_branched(settings) or not learns(settings)[-1]:
        return episodes
    members = settings.values.get("primitive_population_size") or evolution.population_size
    branches = members * settings.estimate.intervals * settings.hierarchy.controller_interval
    return branches if is_alone(settings) else episodes + branches


def make_hyperparameters(problem: Problem) -> Hyperparameters:
    """Return the hyperparameters of Algorithm 1."""
    settings = problem.settings
    evolution, values = settings.evolution, settings.values
    common = {
        name: Schedule(start=values[name], end=values[f"{name}_end"], generations=evolution.schedule_generations)
        for name in ("sigma", "learning_rate")
    }
    return Hyperparameters(
        **common,
        population_size=evolution.population_size,
        episodes_per_policy=evolution.episodes_per_policy,
        updates=_update_rules(settings),
        learns=learns(settings),
        mirrored=evolution.mirrored,
        perturbation=make(PERTURBATIONS, values.get("perturbation", HierarchySettings.perturbation), values),
        common_random_numbers=evolution.common_random_numbers,
        statistics_fraction=evolution.statistics_fraction,
        intervals=_interval_estimate(settings, common) if is_branched(settings) and learns(settings)[-1] else None,
        search=_way_search(problem) if explores(settings) else None,
        horizon=settings.episodes.horizon,
    )


def _interval_estimate(settings: Any, common: Mapping[str, Schedule]) -> IntervalEstimate:
    """Return the interval estimate of the primitive, with its own schedules or the `common` ones."""
    values = settings.values
    own = {name: values.get(f"primitive_{name}") for name in common}
    schedules = {name: common[name] if value is None else Schedule(start=value) for name, value in own.items()}
    return IntervalEstimate(
        **schedules,
        population_size=values.get("primitive_population_size") or settings.evolution.population_size,
        intervals=settings.estimate.intervals,
        controller_interval=settings.hierarchy.controller_interval,
        goal_distance=settings.hierarchy.goal_distance,
    )


def _way_search(problem: Problem) -> WaySearch:
    """Return the search for a way to the target of evaluation."""
    settings, task = problem.settings, problem.make_task(is_evaluation=True)
    task.reset(np.array([0]), [0])
    state, interval = task.states(np.array([0])), settings.hierarchy.controller_interval
    places = task.places(state)
    return WaySearch(
        decode=task.places,
        start=Archive.start(places.cells, places.positions.copy(), state.shape[1]),
        interval=interval,
        interval_s=interval * task.step_s,
        horizon=settings.exploration.explore_horizon or settings.episodes.horizon,
        goal_distance=settings.hierarchy.goal_distance,
        slices=1 if learns(settings)[-1] else SLICES,
    )


def _update_rules(settings: Any) -> tuple[UpdateRule, ...]:
    evolution, values = settings.evolution, settings.values
    rule = UpdateRule(
        weight_decay=evolution.weight_decay,
        holds_when_tied=values["rank_ties"] == "average",
        shaping=make(FITNESS_SHAPINGS, evolution.fitness_shaping, values),
        optimizer=make(OPTIMIZERS, evolution.optimizer, values),
    )
    of_primitive: dict[str, Any] = {"fall_price": values.get("fall_price", rule.fall_price)}
    if is_branched(settings):
        of_primitive["shaping"] = PairRanks()
    return tuple(replace(rule, **of_primitive) if name == "primitive" else rule for name in settings.level_names)
