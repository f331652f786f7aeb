"""From the settings of a run to the hyperparameters of Algorithm 1, and checks that the settings go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from shes.algorithms.contract import Problem
from shes.envs.named_environments import find_environment
from shes.errors import ConfigError
from shes.es.level import UpdateRule
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import MIRRORINGS, check_population_size
from shes.es.shaping import FITNESS_SHAPINGS, PairRanks
from shes.evolution.estimates import Hyperparameters, IntervalEstimate
from shes.evolution.evolution_settings import HierarchySettings
from shes.evolution.state import Archive
from shes.evolution.way_search import WaySearch
from shes.options import make
from shes.settings import flag, out_of_range, setting_fields


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
    return "exploration" in settings and settings.exploration.explore != "none"


def by_episodes(settings: Any) -> tuple[bool, ...]:
    """Return whether each level's mirrored groups are whole episodes: also those of a primitive that learns alone."""
    has_branches = is_branched(settings) and not is_alone(settings)
    return (*learns(settings)[:-1], False) if has_branches else learns(settings)


def practice(settings: Any) -> int:
    """Return the number of generations in which the primitive alone learns: none without branches of its own."""
    return settings.values.get("practice", 0) if is_branched(settings) and learns(settings)[-1] else 0


def population(settings: Any) -> tuple[int, int]:
    """Return the number of policies in a generation, those in branches included, and the most episodes of each."""
    branches = settings.values.get("primitive_population_size") or 0
    return settings.evolution.population_size + branches, settings.evolution.episodes_per_policy


def make_hyperparameters(problem: Problem) -> Hyperparameters:
    """Return the hyperparameters of Algorithm 1."""
    settings = problem.settings
    return Hyperparameters(
        evolution=settings.evolution,
        updates=_update_rules(settings),
        learns=learns(settings),
        perturbation=settings.values.get("perturbation", HierarchySettings.perturbation),
        intervals=_interval_estimate(settings) if is_branched(settings) and learns(settings)[-1] else None,
        search=_way_search(problem) if explores(settings) else None,
        practice=practice(settings),
        horizon=settings.episodes.horizon,
    )


def _interval_estimate(settings: Any) -> IntervalEstimate:
    """Return the interval estimate of the primitive, with its own population and constant rates if it has any."""
    names = ("population_size", "sigma", "learning_rate")
    found = {name: settings.values.get(f"primitive_{name}") for name in names}
    own = {name: value for name, value in found.items() if value is not None}
    constant = {f"{name}_end": None for name in ("sigma", "learning_rate") if name in own}
    return IntervalEstimate(
        evolution=replace(settings.evolution, **own, **constant),
        intervals=settings.estimate.intervals,
        controller_interval=settings.hierarchy.controller_interval,
        goal_distance=settings.hierarchy.goal_distance,
    )


def _way_search(problem: Problem) -> WaySearch:
    settings, task = problem.settings, problem.make_task(is_evaluation=True)
    task.reset(np.array([0]), [0])
    state, interval = task.states(np.array([0])), settings.hierarchy.controller_interval
    places = task.places(state)
    return WaySearch(
        decode=task.places,
        start=Archive.start(places.cells, places.positions.copy(), state.shape[1]),
        interval=interval,
        horizon=settings.exploration.explore_horizon or settings.episodes.horizon,
        goal_distance=settings.hierarchy.goal_distance,
        primitive_learns=learns(settings)[-1],
    )


def _update_rules(settings: Any) -> tuple[UpdateRule, ...]:
    evolution, values = settings.evolution, settings.values
    rule = UpdateRule(
        weight_decay=evolution.weight_decay,
        holds_when_tied=evolution.fitness_shaping != "centred_rank_index",  # as in the authors' code
        shaping=make(FITNESS_SHAPINGS, evolution.fitness_shaping, values),
        optimizer=make(OPTIMIZERS, evolution.optimizer, values),
    )
    of_primitive: dict[str, Any] = {"fall_price": values.get("fall_price", rule.fall_price)}
    if is_branched(settings):
        of_primitive["shaping"] = PairRanks()
    return tuple(replace(rule, **of_primitive) if name == "primitive" else rule for name in settings.level_names)


def check_together(settings: Any) -> None:
    """Raise ConfigError for values that do not go together."""
    if is_alone(settings) and learns(settings) == (False,):
        raise ConfigError(
            f"the primitive {settings.transfer.primitive!r} is frozen, so nothing would learn in a run of "
            f"{settings.run.env}. Set --no-freeze-primitive to train it further."
        )
    _check_population(settings)
    if "hierarchy" in settings:
        _check_frames(settings)
    if is_branched(settings):
        _check_branches(settings)
    if explores(settings):
        _check_exploration(settings)


def _check_population(settings: Any) -> None:
    """Check that the population consists of whole mirrored groups, and fits the shaping."""
    evolution, levels = settings.evolution, by_episodes(settings)
    members = len(MIRRORINGS.find(evolution.mirrored)(max(1, sum(levels))))
    if evolution.fitness_shaping == "pair_rank" and members != 2:
        raise ConfigError(
            f"fitness_shaping 'pair_rank' ranks mirrored pairs, but with mirrored {evolution.mirrored!r} a group "
            f"has {members} member(s) here. Set --fitness-shaping centred_rank, or --mirrored pair."
        )
    perturbation = settings.values.get("perturbation", HierarchySettings.perturbation)
    check_population_size(perturbation, evolution.mirrored, evolution.population_size, levels)


def _check_frames(settings: Any) -> None:
    """Check that what is to turn with the robot is seen from its own frame."""
    hierarchy = settings.hierarchy
    if hierarchy.symmetry != "none" and hierarchy.primitive_view != "egocentric":
        raise ConfigError(
            f"symmetry is {hierarchy.symmetry!r}, but the primitive's view is {hierarchy.primitive_view!r}: only what "
            "is seen from the robot's own frame can be turned. Set --primitive-view egocentric, or --symmetry none."
        )
    if is_alone(settings) or hierarchy.controller_network != "equivariant":
        return
    for name, allowed in {"controller_view": "sectors", "controller_output": "heading_direction"}.items():
        value = getattr(hierarchy, name)
        if value != allowed:
            raise ConfigError(
                f"controller_network is 'equivariant', but {name} is {value!r}, which does not turn with the robot. "
                f"Set {flag(name)} {allowed}, or --controller-network mlp."
            )


def _check_branches(settings: Any) -> None:
    if find_environment(settings.run.env).has_own_physics:
        raise ConfigError(
            f"primitive_estimate is 'interval', but the physics of {settings.run.env} is its own and cannot be "
            "branched. Set --primitive-estimate episode."
        )
    name, members = "population_size", settings.evolution.population_size
    if not is_alone(settings):
        if learns(settings)[-1] and settings.hierarchy.primitive_view == "observation":
            raise ConfigError(
                "primitive_estimate is 'interval', but the primitive sees the task's observation, which a branch does "
                "not continue. Set --primitive-view egocentric or proprioception, or --primitive-estimate episode."
            )
        if own := settings.estimate.primitive_population_size:
            name, members = "primitive_population_size", own
    if members % 2:
        raise out_of_range(name, members, "an even number: branches are mirrored pairs")


def _check_exploration(settings: Any) -> None:
    """Check that a way to the target can be searched for, and found again by the reward."""
    environment: Any = find_environment(settings.run.env)
    asked = f"explore is {settings.exploration.explore!r}, but"
    if not environment.task.has_places:
        raise ConfigError(
            f"{asked} {settings.run.env} has no target with a way to search for: only this package's Maze, Push and "
            "Fall have one. Set --explore none."
        )
    limits, interval = settings.values, settings.hierarchy.controller_interval
    longest = "horizon" if limits["explore_horizon"] is None else "explore_horizon"
    if limits[longest] < interval:
        raise out_of_range(longest, limits[longest], f"at least controller_interval, {interval}: one decision")
    if environment.task.training_square and settings.environment.target is None:
        fault, fix = "the training target is random", "--target, e.g. --target 0 16"
    elif settings.hierarchy.primitive_view == "observation":
        fault = "the primitive sees the task's observation, which a walker does not have"
        fix = "--primitive-view egocentric or proprioception"
    else:
        return
    raise ConfigError(f"{asked} {fault}. Set {fix}, or --explore none.")


def check_effects(settings: Any, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect on the levels that learn."""
    evaluated, useless, why, fix = by_episodes(settings), list[str](), "", ""
    if is_branched(settings) and not learns(settings)[-1]:
        useless = [name for name in setting_fields(type(settings.estimate)) if name != "primitive_estimate"]
        why, fix = "on a frozen primitive", "--no-freeze-primitive"
    elif is_branched(settings) and is_alone(settings):
        useless = ["common_random_numbers", "episodes_per_policy", "fitness_shaping", "mirrored", "statistics_fraction"]
        fix = "--primitive-estimate episode"
        why = "on a primitive that is evaluated by intervals: it applies to whole episodes only"
    if found := [name for name in useless if name in asked]:
        name, *_ = found
        raise ConfigError(f"{name} has no effect {why}; got {asked[name]!r}. Omit {flag(name)}, or set {fix}.")
    if "perturbation" in asked and sum(evaluated) == 1:
        is_one = sum(learns(settings)) == 1
        needed, role = ("learning levels", "learns") if is_one else ("levels evaluated by whole episodes", "is")
        raise ConfigError(
            f"--perturbation needs two {needed}; in this run only the {settings.level_names[evaluated.index(True)]} "
            f"{role}; got {asked['perturbation']!r}. Omit it."
        )


def warnings(settings: Any) -> list[str]:
    """Return a warning if branches are longer than episodes, and one if the run ends before its schedules do."""
    found = list[str]()
    evolution, last = settings.evolution, settings.run.generations
    if is_branched(settings) and learns(settings)[-1]:
        steps, horizon = settings.estimate.intervals * settings.hierarchy.controller_interval, settings.episodes.horizon
        if steps > horizon:
            found.append(f"a branch has {steps} steps, more than an episode ({horizon}): see --intervals")
    if 0 < practice(settings) >= last:
        found.append(f"the controller does not learn: practice takes {practice(settings)} generations: see --practice")
    if (evolution.sigma_end, evolution.learning_rate_end) != (None, None):
        end = practice(settings) + evolution.schedule_generations
        if last < end:
            found.append(f"schedules end after {end} generations, but the run after {last}: see --schedule-generations")
    return found
