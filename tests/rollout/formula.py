"""Generations without physics, in which rewards are a formula, and the comparison of the numbers of runs."""

import itertools
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from shes.backends.backend import Backend
from shes.es.level import LevelState, UpdateRule
from shes.es.statistics import Moments
from shes.evolution.algorithm import evolve
from shes.evolution.estimates import EvolutionSettings, Hyperparameters
from shes.evolution.state import TrainState
from shes.rollout.episodes import EpisodeResults
from tests.es.textbook import TextbookES
from tests.rollout.made_up import outcomes

DIMS = (3, 5)
EPISODES = 3


SETTINGS = Hyperparameters(
    evolution=EvolutionSettings(population_size=8, episodes_per_policy=EPISODES, sigma=0.1, learning_rate=0.02),
    updates=(UpdateRule(weight_decay=0.005),) * 2,
    learns=(True, True),
)


def evolving(settings=SETTINGS, **values):
    """Return `settings` with other values of the settings of evolution."""
    return replace(settings, evolution=replace(settings.evolution, **values))


class FormulaBackend(Backend):
    """Pays each member by a formula of its parameters, and remembers what it was asked.

    The episodes in `diverging`, pairs of member and slot, diverge: they are paid a million. Of every three members, the
    first does not fall, the others fall in one episode of three and half in another.
    """

    num_workers = 3

    def __init__(self, table, diverging=()):
        self.table, self.diverging, self.generations = table, set(diverging), []

    def broadcast(self, state):
        self.generations.append(state)

    def map(self, tasks):
        return (self._results(task, self.generations[-1]) for task in tasks)

    def _results(self, task, generation):
        k, episodes = len(task.slots), generation.episodes_per_policy
        levels = list(zip(generation.levels, task.noise_index, strict=True))
        returns, has_diverged = [], []
        for member, slot in zip(*np.divmod(task.slots, episodes), strict=True):
            signs = task.signs[member]
            policy = [
                level.theta + sign * generation.sigma * self.table.slice(index, len(level.theta))
                for (level, index), sign in zip(levels, signs, strict=True)
            ]
            luck = slot - (episodes - 1) / 2  # each episode pays a little more or less: fitness is a mean over episodes
            has_diverged.append((task.member + member, slot) in self.diverging)
            returns.append([1e6 if has_diverged[-1] else paid + luck for paid in formula(*policy)])
        totals = [[np.full((k, size), total) for total in (14.0, 63.0)] for size in DIMS]
        moments = tuple(Moments(count=np.full(k, 7), total=one, total_squares=other) for one, other in totals)
        steps, members = 100 + np.array(task.slots) % episodes, task.member + np.array(task.slots) // episodes
        return EpisodeResults(
            outcomes=outcomes(np.array(returns), has_diverged=has_diverged, steps=steps, fall=members * steps % 3 / 2),
            moments=moments if task.records_statistics else None,
        )

    def close(self):
        pass


def formula(controller, primitive):
    """Return the made-up fitness of a pair at both levels: they need each other, and are paid differently."""
    controller, primitive = np.asarray(controller, float), np.asarray(primitive, float)
    return -((controller - primitive[:3] - 1) ** 2).sum(), -((primitive - 2) ** 2).sum() + controller[0]


def formula_state(settings=SETTINGS):
    rng = np.random.default_rng(0)
    levels = tuple(
        LevelState.start(name, rng.normal(size=dim).astype(np.float32), rule.optimizer, dim)
        for name, dim, rule in zip(("controller", "primitive"), DIMS, settings.updates, strict=True)
    )
    return TrainState(seed=3, generation=0, env_steps=0, levels=levels)


def formula_run(table, generations, settings=SETTINGS, state=None, pool=None, diverging=()):
    backend = FormulaBackend(table, diverging)
    state = formula_state(settings) if state is None else state
    return backend, list(itertools.islice(evolve(state, settings, table, backend, pool), generations))


def check_against_textbook(table, settings, generations=5, diverging=(), **options):
    """Compare a run with the textbook's; return its backend and its reports."""
    backend, reports = formula_run(table, generations, settings, diverging=diverging)
    own, episodes = settings.evolution, settings.evolution.episodes_per_policy
    book = TextbookES(
        [level.theta for level in backend.generations[0].levels],
        mirrored=own.mirrored, sigma=0.1, rate=0.02, weight_decay=0.005, learns=settings.learns, **options,
    )  # fmt: skip
    for generation, report in enumerate(reports):
        book.sigma, book.rate = own.value("sigma", generation), own.value("learning_rate", generation)
        rows = zip(report.populations[0].noise_index, DIMS, strict=True)
        noise = [[table.slice(i, dim) for i in row.tolist()] for row, dim in rows]
        paid = np.array([formula(*pair) for pair in book.candidates(noise)]).T[:, :, None]
        paid = paid + np.arange(episodes) - (episodes - 1) / 2
        for level in paid:  # a divergence counts as the worst of the others
            others = [level[m, e] for m, e in np.ndindex(level.shape) if (m, e) not in diverging]
            for place in diverging:
                level[place] = min(others)
        assert report.populations[0].results.fitness == pytest.approx(paid.mean(axis=2), rel=1e-4, abs=1e-4)
        book.update(report.populations[0].results.fitness.tolist(), noise)
        for level, theta in zip(report.state.levels, book.thetas, strict=True):
            assert level.theta == pytest.approx(theta, abs=1e-5)
    return backend, reports


def leaves(value, place=""):
    """Yield the arrays, numbers and texts in a state, a report or a part of one, with their places; no durations."""
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
        value = {name: getattr(value, name) for name in names if name != "seconds" and not name.endswith("_s")}
    elif isinstance(value, np.ndarray) and value.dtype.names:
        value = {name: value[name] for name in value.dtype.names}
    if not isinstance(value, (dict, list, tuple)):
        yield place, value
        return
    for name, each in value.items() if isinstance(value, dict) else enumerate(value):
        yield from leaves(each, f"{place}/{name}")


def bits(value):
    """Return the bytes or the text of each of the `leaves` of `value` by place."""
    return {at: leaf.tobytes() if isinstance(leaf, np.ndarray) else repr(leaf) for at, leaf in leaves(value)}
