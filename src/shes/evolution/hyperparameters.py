"""From the settings of a run to the hyperparameters of Algorithm 1 and the initial state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from shes.agents.agent import AgentDesign
from shes.algorithms.problem import Problem
from shes.es.level import LevelState, UpdateRule
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import FITNESS_SHAPINGS, PairRanks
from shes.evolution.archive import Archive
from shes.evolution.estimates import Hyperparameters, IntervalEstimate, Schedule
from shes.evolution.evolution_settings import HierarchySettings
from shes.evolution.state import TrainState
from shes.evolution.way_search import SLICES, WaySearch
from shes.options import make
from shes.streams import Purpose, stream


def learns(settings: Any) -> tuple[bool, ...]:
    """Return whether each level learns."""
    is_frozen = (
        "transfer" in settings and settings.transfer.primitive is not None and settings.transfer.freeze_primitive
    )
    return tuple(not (is_frozen and name == "primitive") for name in settings.level_names)


def is_alone(settings: Any) -> bool:
    """Return whether there is only a primitive, because the environment sets the goals."""
    return settings.level_names == ("primitive",)


def is_branched(settings: Any) -> bool:
    """Return whether the primitive's fitness is estimated by branched intervals, even if it does not learn."""
    return "estimate" in settings and settings.estimate.primitive_estimate == "interval"


def explores(settings: Any) -> bool:
    """Return whether the run searches for a way to the target."""
    return "exploration" in settings and settings.exploration.explore == "archive"


def by_episodes(settings: Any) -> tuple[bool, ...]:
    """Return whether each level's mirrored groups are whole episodes: also those of a primitive that learns alone."""
    if is_branched(settings) and not is_alone(settings):
        return (*learns(settings)[:-1], False)
    return learns(settings)


def population(settings: Any) -> tuple[int, int]:
    """Return the number of policies in a generation, those in branches included, and the most episodes of each."""
    evolution = settings.evolution
    branches = settings.values.get("primitive_population_size") or 0
    return evolution.population_size + branches, evolution.episodes_per_policy


def steps_per_generation(settings: Any) -> int:
    """Return the environment steps of a generation if no episode and no branch ends early."""
    evolution = settings.evolution
    episodes = evolution.population_size * evolution.episodes_per_policy * settings.episodes.horizon
    if not is_branched(settings) or not learns(settings)[-1]:
        return episodes
    pairs = settings.values.get("primitive_population_size") or evolution.population_size
    branches = pairs * settings.estimate.intervals * settings.hierarchy.controller_interval
    return branches if is_alone(settings) else episodes + branches


def make_hyperparameters(problem: Problem) -> Hyperparameters:
    """Return the hyperparameters of Algorithm 1."""
    settings = problem.settings
    evolution, values = settings.evolution, settings.values
    sigma, learning_rate = _schedule(evolution, "sigma"), _schedule(evolution, "learning_rate")
    return Hyperparameters(
        population_size=evolution.population_size,
        episodes_per_policy=evolution.episodes_per_policy,
        sigma=sigma,
        learning_rate=learning_rate,
        updates=make_update_rules(settings),
        learns=learns(settings),
        mirrored=evolution.mirrored,
        perturbation=make(PERTURBATIONS, values.get("perturbation", HierarchySettings.perturbation), values),
        common_random_numbers=evolution.common_random_numbers,
        statistics_fraction=evolution.statistics_fraction,
        intervals=_interval_estimate(settings, sigma, learning_rate),
        search=_way_search(problem) if explores(settings) else None,
        horizon=settings.episodes.horizon,
    )


def _schedule(evolution: Any, name: str) -> Schedule:
    """Return the schedule of the quantity called `name`."""
    start, end = getattr(evolution, name), getattr(evolution, f"{name}_end")
    return Schedule(start=start, end=end, generations=evolution.schedule_generations)


def _way_search(problem: Problem) -> WaySearch:
    """Return the search for a way to the target of evaluation."""
    settings, task = problem.settings, problem.make_task(is_evaluation=True)
    task.reset(np.array([0]), [0])
    state = task.states(np.array([0]))
    places = task.places(state)
    interval = settings.hierarchy.controller_interval
    return WaySearch(
        decode=task.places,
        start=Archive.start(places.cells, places.positions.copy(), state.shape[1]),
        interval=interval,
        interval_s=interval * task.step_s,
        horizon=settings.exploration.explore_horizon or settings.episodes.horizon,
        goal_distance=settings.hierarchy.goal_distance,
        slices=1 if learns(settings)[-1] else SLICES,
    )


def _interval_estimate(settings: Any, sigma: Schedule, learning_rate: Schedule) -> IntervalEstimate | None:
    """Return the interval estimate of the primitive, or None. `sigma` and `learning_rate` are those of the run."""
    if not is_branched(settings) or not learns(settings)[-1]:
        return None
    values = settings.values

    def own(quantity: str, shared: Schedule) -> Schedule:
        value = values.get(quantity)
        return shared if value is None else Schedule(start=value)

    return IntervalEstimate(
        population_size=values.get("primitive_population_size") or settings.evolution.population_size,
        intervals=settings.estimate.intervals,
        controller_interval=settings.hierarchy.controller_interval,
        goal_distance=settings.hierarchy.goal_distance,
        sigma=own("primitive_sigma", sigma),
        learning_rate=own("primitive_learning_rate", learning_rate),
    )


def make_update_rules(settings: Any) -> tuple[UpdateRule, ...]:
    """Return the update rule of each level."""
    evolution, values = settings.evolution, settings.values
    rule = UpdateRule(
        weight_decay=evolution.weight_decay,
        holds_when_tied=values["rank_ties"] == "average",
        shaping=make(FITNESS_SHAPINGS, evolution.fitness_shaping, values),
        optimizer=make(OPTIMIZERS, evolution.optimizer, values),
    )
    own: dict[str, dict[str, Any]] = {}
    if "estimate" in settings:
        own["primitive"] = {"fall_price": settings.estimate.fall_price}
    if is_branched(settings):
        own["primitive"]["shaping"] = PairRanks()
    return tuple(replace(rule, **own.get(name, {})) for name in settings.level_names)


def make_state(settings: Any, design: AgentDesign, seed: int) -> TrainState:
    """Return the state before the first generation, without transferred parameters."""
    networks, levels = settings.networks, list[LevelState]()
    parts = zip(design.level_names, design.policies, make_update_rules(settings), strict=True)
    for number, (name, policy, rule) in enumerate(parts):
        rng = stream(seed, Purpose.INITIAL_PARAMETERS, number)
        theta = policy.initial(rng, networks.biases, networks.output_weights)
        levels.append(LevelState.start(name, theta, rule.optimizer, policy.sizes[0]))
    return TrainState(seed=seed, generation=0, env_steps=0, levels=tuple(levels))
