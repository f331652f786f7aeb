"""From the settings of a run to the numbers of Algorithm 1, and the state before its first generation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shes.algorithms.evolution.populations import Settings
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.novelty import make_novelty_rule
from shes.es.optimizers import make_optimizer
from shes.es.perturbation import make_perturbation
from shes.es.schedules import Schedule, make_schedule
from shes.es.shaping import make_fitness_shaping
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.intervals import IntervalEstimate

__all__ = ["SCHEDULED", "make_settings", "make_state", "make_update_rules"]

SCHEDULED = {
    "learning_rate": ("learning_rate_schedule", "learning_rate_end"),
    "sigma": ("sigma_schedule", "sigma_end"),
    "episodes_per_policy": ("episodes_schedule", "episodes_end"),
}
"""What may change over generations: the settings that say how, and to what."""


def make_settings(settings: Any) -> Settings:
    """Return the numbers of Algorithm 1."""

    def schedule(name: str) -> Schedule:
        kind, end = SCHEDULED[name]
        start, quantity = getattr(settings, name), kind.removesuffix("_schedule")
        stop = start if getattr(settings, end) is None else getattr(settings, end)
        return make_schedule(quantity, getattr(settings, kind), start, stop, settings.schedule_generations)

    return Settings(
        population_size=settings.population_size,
        episodes_per_policy=schedule("episodes_per_policy"),
        sigma=schedule("sigma"),
        learning_rate=schedule("learning_rate"),
        updates=make_update_rules(settings),
        learns=settings.learns,
        mirrored=settings.mirrored,
        perturbation=make_perturbation(settings.perturbation),
        common_random_numbers=settings.common_random_numbers,
        statistics_fraction=settings.statistics_fraction,
        novelty=None if settings.novelty == "none" else make_novelty_rule(settings.novelty),
        novelty_neighbours=settings.novelty_neighbours,
        intervals=_interval_estimate(settings, schedule("sigma"), schedule("learning_rate")),
        horizon=settings.horizon,
    )


def _interval_estimate(settings: Any, sigma: Schedule, learning_rate: Schedule) -> IntervalEstimate | None:
    """Return how the primitive is judged by intervals, if it is and learns; the schedules are those of the run."""
    if settings.primitive_estimate != "interval" or not settings.learns[-1]:
        return None

    def own(quantity: str, value: float | None, shared: Schedule) -> Schedule:
        return shared if value is None else make_schedule(quantity, "constant", value, value, 1)

    return IntervalEstimate(
        population_size=settings.primitive_population_size or settings.population_size,
        intervals=settings.intervals,
        controller_interval=settings.controller_interval,
        horizon=settings.horizon,
        goal_distance=settings.goal_distance,
        update=make_update_rules(settings)[-1],
        sigma=own("primitive_sigma", settings.primitive_sigma, sigma),
        learning_rate=own("primitive_learning_rate", settings.primitive_learning_rate, learning_rate),
    )


def make_update_rules(settings: Any) -> tuple[UpdateRule, ...]:
    """Return how fitness becomes a step, for each level."""
    rule = UpdateRule(
        weight_decay=settings.weight_decay,
        decouples_decay=settings.weight_decay_form == "decoupled",
        holds_when_tied=settings.hold_tied,
        shaping=make_fitness_shaping(settings.fitness_shaping, ties=settings.rank_ties, fraction=settings.top_fraction),
        optimizer=make_optimizer(settings.optimizer, momentum=settings.momentum),
    )
    own: dict[str, dict[str, Any]] = {"primitive": {"fall_price": settings.fall_price}}
    if settings.controller_weight_decay is not None:
        own["controller"] = {"weight_decay": settings.controller_weight_decay}
    if settings.primitive_estimate == "interval":
        name = settings.primitive_fitness_shaping
        own["primitive"]["shaping"] = make_fitness_shaping(
            name, ties=settings.rank_ties, fraction=settings.top_fraction
        )
    return tuple(replace(rule, **own.get(name, {})) for name in settings.level_names)


def make_state(settings: Any, design: AgentDesign, seed: int) -> TrainState:
    """Return the state before the first generation; a primitive that is transferred comes in later."""
    levels: list[LevelState] = []
    rules = make_update_rules(settings)
    for number, (policy, size) in enumerate(zip(design.policies, design.observation_sizes, strict=True)):
        rng = stream(seed, Purpose.INITIAL_PARAMETERS, number)
        theta = policy.initial(rng, settings.biases, settings.output_weights)
        levels.append(
            LevelState(
                name=design.level_names[number],
                theta=theta,
                optimizer=rules[number].optimizer.start(len(theta)),
                statistics=ObservationStatistics.empty(size),
            )
        )
    novelty = None if settings.novelty == "none" else make_novelty_rule(settings.novelty).start()
    return TrainState(seed=seed, generation=0, env_steps=0, levels=tuple(levels), novelty=novelty)
