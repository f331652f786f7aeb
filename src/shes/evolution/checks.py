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

_WHOLE_GROUPS = 48
"""Members of a population that has whole mirrored groups, however they are mirrored and perturbed."""
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
    if "hierarchy" in settings and not is_alone(settings) and settings.hierarchy.controller_network == "equivariant":
        _check_equivariant(settings.hierarchy)
    if is_branched(settings):
        _check_branches(settings)
    if explores(settings):
        _check_exploration(settings)


def _check_population(settings: Any) -> None:
    """Check that the population consists of whole mirrored groups, and fits shaping and symmetry."""
    evolution, levels = settings.evolution, by_episodes(settings)
    members = len(sign_matrix(evolution.mirrored, max(1, sum(levels))))
    if evolution.fitness_shaping == "pair_rank" and members != 2:
        raise ConfigError(
            f"fitness_shaping 'pair_rank' ranks mirrored pairs, but with mirrored {evolution.mirrored!r} a group "
            f"has {members} member(s) here. Set --mirrored pair, or another --fitness-shaping."
        )
    if (
        "hierarchy" in settings
        and settings.hierarchy.symmetry != "none"
        and not PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view).is_egocentric
    ):
        raise ConfigError(
            f"symmetry is {settings.hierarchy.symmetry!r}, but the primitive's view is "
            f"{settings.hierarchy.primitive_view!r}: only what is seen from the robot's own frame can be turned. "
            "Set --primitive-view egocentric, or --symmetry none."
        )
    perturbation = PERTURBATIONS.find(settings.values.get("perturbation", HierarchySettings.perturbation))()
    # A population of the same remainder tells as much, without an array of every member.
    small = min(evolution.population_size, _WHOLE_GROUPS + evolution.population_size % _WHOLE_GROUPS)
    try:
        perturbation.signs(0, small, evolution.mirrored, levels)
    except ConfigError:  # the message is to have the size that was asked for
        perturbation.signs(0, evolution.population_size, evolution.mirrored, levels)


def _check_equivariant(hierarchy: Any) -> None:
    """Check that the controller's view and output turn with the robot."""
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
    is_beside = not is_alone(settings)
    if is_beside and learns(settings)[-1] and PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view).sees_task:
        raise ConfigError(
            "primitive_estimate is 'interval', but the primitive sees the task's observation, which a branch does "
            "not continue. Set --primitive-view egocentric or proprioception, or --primitive-estimate episode."
        )
    own = settings.estimate.primitive_population_size if is_beside else None
    name, pairs = ("primitive_population_size", own) if own else ("population_size", settings.evolution.population_size)
    if pairs % 2:
        raise out_of_range(name, pairs, "an even number: branches are mirrored pairs")


def _check_exploration(settings: Any) -> None:
    """Check that a way to the target can be searched for, and found again by the reward."""
    if not find_environment(settings.run.env).has_places:
        raise ConfigError(
            f"explore is 'archive', but {settings.run.env} has no target with a way to search for: only Maze, Push and "
            "Fall of this package have. Set --explore none."
        )
    longest, interval = settings.exploration.explore_horizon, settings.hierarchy.controller_interval
    if longest is not None and longest < interval:
        raise out_of_range("explore_horizon", longest, f"at least controller_interval, {interval}: one decision")
    options = settings.environment
    if options.waypoints is not None:
        raise ConfigError(
            f"explore is 'archive', but waypoints {options.waypoints} are a way already. Set --waypoints none, or "
            "--explore none."
        )
    if options.has_random_target:
        raise ConfigError(
            "explore is 'archive', but the training target is random. Set --target, e.g. --target 0 16, or "
            "--explore none."
        )
    environment: Any = find_environment(settings.run.env)
    own = environment.task.own_target
    target, sought = options.target or own, options.evaluation_target or own
    if target != sought:
        raise ConfigError(
            f"explore is 'archive', which searches for a way to evaluation's target {sought}, but the training target "
            f"is {target}. Set --target {' '.join(f'{x:g}' for x in sought)}, or --explore none."
        )
    if PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view).sees_task:
        raise ConfigError(
            "explore is 'archive', but the primitive sees the task's observation, which a walker does not have. "
            "Set --primitive-view egocentric or proprioception, or --explore none."
        )


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
        level = settings.level_names[evaluated.index(True)]
        needed, role = "learning levels", "learns"
        if sum(learns(settings)) > 1:
            needed, role = "levels evaluated by whole episodes", "is"
        raise ConfigError(
            f"--perturbation needs two {needed}; in this run only the {level} {role}; got "
            f"{asked['perturbation']!r}. Omit it."
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
