"""From the settings of a run to the numbers of Algorithm 1, and the state before its first generation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shes.algorithms.evolution.populations import Settings
from shes.algorithms.evolution.rooms import SCHEDULED
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.novelty import make_novelty_rule
from shes.es.optimizers import make_optimizer
from shes.es.perturbation import make_perturbation
from shes.es.schedules import Schedule, make_schedule
from shes.es.shaping import FitnessShaping, make_fitness_shaping
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.intervals import IntervalEstimate

__all__ = ["make_settings", "make_state", "make_update_rules"]


def make_settings(settings: Any) -> Settings:
    """Return the numbers of Algorithm 1."""
    evolution, values = settings.evolution, settings.settings

    def schedule(name: str) -> Schedule:
        kind, end = SCHEDULED[name]
        start, quantity = values[name], kind.removesuffix("_schedule")
        stop = start if values[end] is None else values[end]
        return make_schedule(quantity, values[kind], start, stop, settings.schedules.schedule_generations)

    novelty = values.get("novelty", "none")
    return Settings(
        population_size=evolution.population_size,
        episodes_per_policy=schedule("episodes_per_policy"),
        sigma=schedule("sigma"),
        learning_rate=schedule("learning_rate"),
        updates=make_update_rules(settings),
        learns=settings.learns,
        mirrored=evolution.mirrored,
        perturbation=make_perturbation(values.get("perturbation", "many_to_many")),
        common_random_numbers=evolution.common_random_numbers,
        statistics_fraction=evolution.statistics_fraction,
        novelty=None if novelty == "none" else make_novelty_rule(novelty),
        novelty_neighbours=values.get("novelty_neighbours", 10),
        intervals=_interval_estimate(settings, schedule("sigma"), schedule("learning_rate")),
        horizon=settings.episodes.horizon,
    )


def _interval_estimate(settings: Any, sigma: Schedule, learning_rate: Schedule) -> IntervalEstimate | None:
    """Return how the primitive is judged by intervals, if it is and learns; the schedules are those of the run."""
    if not settings.is_branched or not settings.learns[-1]:
        return None
    values = settings.settings

    def own(quantity: str, shared: Schedule) -> Schedule:
        value = values.get(quantity)
        return shared if value is None else make_schedule(quantity, "constant", value, value, 1)

    return IntervalEstimate(
        population_size=values.get("primitive_population_size") or settings.evolution.population_size,
        intervals=settings.estimate.intervals,
        controller_interval=settings.hierarchy.controller_interval,
        horizon=settings.episodes.horizon,
        goal_distance=settings.hierarchy.goal_distance,
        update=make_update_rules(settings)[-1],
        sigma=own("primitive_sigma", sigma),
        learning_rate=own("primitive_learning_rate", learning_rate),
    )


def make_update_rules(settings: Any) -> tuple[UpdateRule, ...]:
    """Return how fitness becomes a step, for each level."""
    evolution = settings.evolution

    def shaping(name: str) -> FitnessShaping:
        return make_fitness_shaping(name, ties=evolution.rank_ties, fraction=evolution.top_fraction)

    rule = UpdateRule(
        weight_decay=evolution.weight_decay,
        decouples_decay=evolution.weight_decay_form == "decoupled",
        holds_when_tied=evolution.hold_tied,
        shaping=shaping(evolution.fitness_shaping),
        optimizer=make_optimizer(evolution.optimizer, momentum=evolution.momentum),
    )
    own: dict[str, dict[str, Any]] = {}
    if "estimate" in settings:
        own["primitive"] = {"fall_price": settings.estimate.fall_price}
    if settings.is_branched:
        own["primitive"]["shaping"] = shaping(settings.estimate.primitive_fitness_shaping)
    decay = settings.settings.get("controller_weight_decay")
    if decay is not None:
        own["controller"] = {"weight_decay": decay}
    return tuple(replace(rule, **own.get(name, {})) for name in settings.level_names)


def make_state(settings: Any, design: AgentDesign, seed: int) -> TrainState:
    """Return the state before the first generation; a primitive that is transferred comes in later."""
    levels: list[LevelState] = []
    rules = make_update_rules(settings)
    for number, (policy, size) in enumerate(zip(design.policies, design.observation_sizes, strict=True)):
        rng = stream(seed, Purpose.INITIAL_PARAMETERS, number)
        theta = policy.initial(rng, settings.networks.biases, settings.networks.output_weights)
        levels.append(
            LevelState(
                name=design.level_names[number],
                theta=theta,
                optimizer=rules[number].optimizer.start(len(theta)),
                statistics=ObservationStatistics.empty(size),
            )
        )
    rule = settings.settings.get("novelty", "none")
    novelty = None if rule == "none" else make_novelty_rule(rule).start()
    return TrainState(seed=seed, generation=0, env_steps=0, levels=tuple(levels), novelty=novelty)
