"""Generations without physics, in which rewards are a formula, and the comparison of the numbers of runs."""

import itertools

import numpy as np
import pytest

from shes.algorithms.evolution.algorithm import Hyperparameters, evolve
from shes.backends.backend import Backend
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.schedules import Schedule
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import EpisodeResults
from shes.hierarchy.moments import Moments
from tests.es.textbook import TextbookES
from tests.hierarchy.made_up import outcomes

DIMS = (3, 5)
EPISODES = 3


def constant(value):
    return Schedule(start=value)


def changing(start, end, generations):
    return Schedule(start=start, end=end, generations=generations)


SETTINGS = Hyperparameters(
    population_size=8,
    episodes_per_policy=EPISODES,
    sigma=constant(0.1),
    learning_rate=constant(0.02),
    updates=(UpdateRule(weight_decay=0.005),) * 2,
    learns=(True, True),
)


def start_state(thetas, sizes, *, seed=3, settings=SETTINGS, names=("controller", "primitive")):
    levels = tuple(
        LevelState(
            name=name, theta=theta, optimizer=rule.optimizer.start(len(theta)),
            statistics=ObservationStatistics.empty(size),
        )
        for name, theta, size, rule in zip(names, thetas, sizes, settings.updates, strict=True)
    )  # fmt: skip
    return TrainState(seed=seed, generation=0, env_steps=0, levels=levels)


_DRIFT_M = ((0.0, 0.0), (0.1, 0.3), (0.5, -0.2), (0.3, 0.6))  # lopsided, or mirrored members would tie


class FormulaBackend(Backend):
    """Pays each member by a formula of its parameters, and remembers what it was asked."""

    num_workers = 3

    def __init__(self, table, diverging=()):
        """Let the episodes in `diverging`, pairs of member and slot, diverge: they are paid a million."""
        self.table = table
        self.diverging = set(diverging)
        self.generations = []
        self.tasks = []

    def broadcast(self, state):
        self.generations.append(state)
        self.tasks.append([])

    def map(self, tasks):
        for task in tasks:
            self.tasks[-1].append(task)
            generation = self.generations[-1]
            policies = [
                [
                    level.theta + sign * generation.sigma * self.table.slice(index, len(level.theta))
                    for level, sign, index in zip(generation.levels, signs, task.noise_index, strict=True)
                ]
                for signs in task.signs
            ]
            k, episodes = len(task.slots), generation.episodes_per_policy
            members, slots = np.divmod(task.slots, episodes)
            moments = tuple(
                Moments(count=np.full(k, 7), total=np.full((k, size), 14.0), total_squares=np.full((k, size), 63.0))
                for size in DIMS
            )
            # Each episode pays a little more or less, so that fitness is a mean over episodes.
            luck = slots - (episodes - 1) / 2
            places = zip((task.member + members).tolist(), slots.tolist(), strict=True)
            has_diverged = np.array([place in self.diverging for place in places])
            returns = np.array([formula(*policies[member]) for member in members]).T + luck
            yield EpisodeResults(
                outcomes=outcomes(
                    returns=np.where(has_diverged, 1e6, returns).T,
                    score=luck,
                    success=luck > 0,
                    steps=100 + slots,
                    has_terminated=luck > 0,
                    has_fallen=luck > 0,
                    has_diverged=has_diverged,
                    goals_reached=slots,
                    final_position=np.array(
                        [end_of(policies[m][0], [slot])[0] for m, slot in zip(members, slots, strict=True)]
                    ),
                    environment_returns=returns[0] + 5,
                ),
                moments=moments if task.records_statistics else None,
            )

    def close(self):
        pass


def end_of(controller, slots):
    """Return the made-up ends [K, 2] of a controller's episodes in `slots`, all in their own direction."""
    return np.asarray(controller, float)[:2] * 3 + [_DRIFT_M[slot] for slot in slots]


def formula(controller, primitive):
    """Return the made-up fitness of a pair at both levels: they need each other, and are paid differently."""
    controller, primitive = np.asarray(controller, float), np.asarray(primitive, float)
    return -((controller - primitive[:3] - 1) ** 2).sum(), -((primitive - 2) ** 2).sum() + controller[0]


def formula_state(settings=SETTINGS):
    rng = np.random.default_rng(0)
    return start_state([rng.normal(size=dim).astype(np.float32) for dim in DIMS], DIMS, settings=settings)


def formula_run(table, generations, settings=SETTINGS, state=None, pool=None, diverging=()):
    backend = FormulaBackend(table, diverging)
    state = formula_state(settings) if state is None else state
    return backend, list(itertools.islice(evolve(state, settings, table, backend, pool), generations))


def noise_of(report, table):
    return [
        [table.slice(i, dim) for i in row.tolist()]
        for row, dim in zip(report.population.work.noise_index, DIMS, strict=True)
    ]


def check_against_textbook(table, settings, generations=5, **options):
    """Compare a run with the textbook's; return its reports."""
    backend, reports = formula_run(table, generations, settings)
    book = TextbookES(
        [level.theta for level in backend.generations[0].levels],
        mirrored=settings.mirrored, sigma=0.1, rate=0.02, weight_decay=0.005, learns=settings.learns, **options,
    )  # fmt: skip
    for generation, report in enumerate(reports):
        book.sigma, book.rate = settings.sigma.value(generation), settings.learning_rate.value(generation)
        noise = noise_of(report, table)
        expected = np.array([formula(*pair) for pair in book.candidates(noise)]).T
        assert report.results.fitness == pytest.approx(expected, rel=1e-4, abs=1e-4)
        book.update(report.results.fitness.tolist(), noise)
        for level, theta in zip(report.state.levels, book.thetas, strict=True):
            assert level.theta == pytest.approx(theta, abs=1e-5)
    return reports


def state_bits(state):
    arrays = [
        a
        for level in state.levels
        for a in (level.theta, *level.optimizer.slots.values(), level.statistics.total, level.statistics.total_squares)
    ]
    counts = [(level.name, level.optimizer.steps, level.statistics.count) for level in state.levels]
    if state.running is not None:
        arrays += [state.running.states, state.running.steps]
    return [a.tobytes() for a in arrays], counts, state.generation, state.env_steps, state.seed


def run_bits(reports):
    return [
        (
            state_bits(report.state),
            population_bits(report.population),
            None if report.branches is None else population_bits(report.branches),
            [repr((u.gradient_norm, u.halves_cosine, u.update_ratio)) for u in report.updates],
        )
        for report in reports
    ]


def population_bits(population):
    results, work = population.results, population.work
    arrays = (
        results.returns, results.score, results.success, results.steps, results.has_terminated, results.has_fallen,
        results.has_diverged, results.goals_reached, results.final_position, results.environment_returns,
        work.noise_index, work.signs,
    )  # fmt: skip
    left = [(place, end.state.tobytes(), end.steps, end.goals.tobytes()) for place, end in results.snapshots.items()]
    return [array.tobytes() for array in arrays], left, work.generation.sigma, population.learning_rate


def same_level(one, other):
    """Return whether parameters and optimizer of two levels are bit-identical."""
    return (
        one.theta.tobytes() == other.theta.tobytes()
        and one.optimizer.steps == other.optimizer.steps
        and all(slot.tobytes() == other.optimizer.slots[name].tobytes() for name, slot in one.optimizer.slots.items())
    )
