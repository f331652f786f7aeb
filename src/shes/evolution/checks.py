"""Checks of the settings of the evolution strategies: values that do not go together, or have no effect."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.agents.views import PRIMITIVE_VIEWS
from shes.envs.named_environments import find_environment
from shes.errors import ConfigError
from shes.es.perturbation import PERTURBATIONS, sign_matrix
from shes.evolution.evolution_settings import HierarchySettings
from shes.evolution.hyperparameters import by_episodes, explores, is_alone, is_branched, learns
from shes.settings import flag, out_of_range, setting_fields

_OF_EPISODES = ("common_random_numbers", "episodes_per_policy", "fitness_shaping", "mirrored", "statistics_fraction")
"""Settings of whole episodes, without effect on a primitive that learns alone from intervals."""


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
    members = len(sign_matrix(evolution.mirrored, max(1, sum(levels))))
    if evolution.fitness_shaping == "pair_rank" and members != 2:
        raise ConfigError(
            f"fitness_shaping 'pair_rank' ranks mirrored pairs, but with mirrored {evolution.mirrored!r} a group "
            f"has {members} member(s) here. Set --mirrored pair, or another --fitness-shaping."
        )
    perturbation = PERTURBATIONS.find(settings.values.get("perturbation", HierarchySettings.perturbation))()
    perturbation.check_size(evolution.population_size, evolution.mirrored, levels)


def _check_frames(settings: Any) -> None:
    """Check that what is to turn with the robot is seen from its own frame."""
    hierarchy = settings.hierarchy
    if hierarchy.symmetry != "none" and not PRIMITIVE_VIEWS.find(hierarchy.primitive_view).is_egocentric:
        raise ConfigError(
            f"symmetry is {hierarchy.symmetry!r}, but the primitive's view is {hierarchy.primitive_view!r}: only what "
            "is seen from the robot's own frame can be turned. Set --primitive-view egocentric, or --symmetry none."
        )
    if is_alone(settings) or hierarchy.controller_network != "equivariant":
        return
    allowed = {"controller_view": ("sectors",), "controller_output": ("heading_direction", "heading_vector")}
    for name, values in allowed.items():
        value = getattr(hierarchy, name)
        if value not in values:
            raise ConfigError(
                f"controller_network is 'equivariant', but {name} is {value!r}, which does not turn with the robot. "
                f"Set {flag(name)} {' or '.join(values)}, or --controller-network mlp."
            )


def _check_branches(settings: Any) -> None:
    """Check that the primitive's episodes can be branched."""
    if find_environment(settings.run.env).has_own_physics:
        raise ConfigError(
            f"primitive_estimate is 'interval', but the physics of {settings.run.env} is its own and cannot be "
            "branched. Set --primitive-estimate episode."
        )
    name, members = "population_size", settings.evolution.population_size
    if not is_alone(settings):
        if learns(settings)[-1] and PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view).sees_task:
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
    if not environment.task.has_places:
        raise ConfigError(
            f"explore is 'archive', but {settings.run.env} has no target with a way to search for: only Maze, Push and "
            "Fall of this package have. Set --explore none."
        )
    longest, interval = settings.exploration.explore_horizon, settings.hierarchy.controller_interval
    if longest is not None and longest < interval:
        raise out_of_range("explore_horizon", longest, f"at least controller_interval, {interval}: one decision")
    options, own = settings.environment, environment.task.own_target
    target, sought = options.target or own, options.evaluation_target or own
    if options.waypoints is not None:
        fault, fix = f"waypoints {options.waypoints} are a way already", "--waypoints none"
    elif options.has_random_target:
        fault, fix = "the training target is random", "--target, e.g. --target 0 16"
    elif target != sought:
        fault = f"it searches for a way to evaluation's target {sought}, while the training target is {target}"
        fix = f"--target {' '.join(f'{x:g}' for x in sought)}"
    elif PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view).sees_task:
        fault = "the primitive sees the task's observation, which a walker does not have"
        fix = "--primitive-view egocentric or proprioception"
    else:
        return
    raise ConfigError(f"explore is 'archive', but {fault}. Set {fix}, or --explore none.")


def check_effects(settings: Any, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect on the levels that learn."""
    if is_branched(settings) and not learns(settings)[-1]:
        for name in setting_fields(type(settings.estimate)):
            if name in asked and name != "primitive_estimate":
                raise ConfigError(
                    f"{name} has no effect on a frozen primitive; got {asked[name]!r}. "
                    f"Omit {flag(name)}, or set --no-freeze-primitive."
                )
    if is_branched(settings) and is_alone(settings):
        for name in _OF_EPISODES:
            if name in asked:
                raise ConfigError(
                    f"{name} has no effect in a run of {settings.run.env} whose primitive is evaluated by intervals: "
                    f"it applies to whole episodes only; got {asked[name]!r}. "
                    f"Omit {flag(name)}, or set --primitive-estimate episode."
                )
    evaluated = by_episodes(settings)
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
    if (evolution.sigma_end, evolution.learning_rate_end) != (None, None) and last < evolution.schedule_generations:
        found.append(
            f"the schedules take {evolution.schedule_generations} generations, but the run ends after {last}, short "
            "of their end: see --schedule-generations"
        )
    return found
