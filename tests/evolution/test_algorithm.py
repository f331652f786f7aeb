"""`evolve` on made-up fitness: the textbook's iterates, whoever is perturbed; schedules, and levels that rest.

What is drawn is in `rollout/test_population.py`; the same bits on any workers, in `e2e/test_same_numbers.py`.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import SGD
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import CentredRanks, IndexedRanks
from shes.evolution.estimates import EvolutionSettings
from tests.rollout.formula import (
    DIMS,
    EPISODES,
    SETTINGS,
    bits,
    check_against_textbook,
    evolving,
    formula_run,
    formula_state,
)

positive = st.floats(1e-6, 1e6)


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("learns", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("name", sorted(PERTURBATIONS))
def test_generations_are_the_textbooks(table, name, learns, mirrored):
    settings = replace(evolving(population_size=12, mirrored=mirrored), learns=learns)
    check_against_textbook(table, replace(settings, perturbation=name), perturbation=name)


@pytest.mark.parametrize("diverging", [(), ((2, 0), (7, 1))], ids=["finite", "diverging"])
@pytest.mark.parametrize(("shaping", "ties"), [(CentredRanks(), "average"), (IndexedRanks(), "index")])
def test_ties_and_divergences_are_the_textbooks(table, shaping, ties, diverging):
    rule = UpdateRule(weight_decay=0.005, shaping=shaping)
    settings = replace(SETTINGS, updates=(rule, rule))
    backend, reports = check_against_textbook(table, settings, diverging=diverging, ties=ties)
    whole = 8 * (100 + 101 + 102)
    assert [(each.state.generation, each.state.env_steps) for each in reports] == [(k, k * whole) for k in range(1, 6)]
    for generation, report in zip(backend.generations[1:], reports, strict=False):
        assert generation.kind == "training"
        for sent, level, dim in zip(generation.levels, report.state.levels, DIMS, strict=True):
            assert sent.theta.tobytes() == level.theta.tobytes()
            assert sent.mean == pytest.approx(np.full(dim, 2))  # 14 / 7
            assert 1 / sent.inverse_std == pytest.approx(np.full(dim, 5**0.5))  # 63 / 7 - 4
    assert [level.inverse_std.tolist() for level in backend.generations[0].levels] == [[1] * dim for dim in DIMS]


def test_generations_with_schedules_are_the_textbooks(table):
    scheduled = evolving(sigma_end=0.025, learning_rate_end=0.001, schedule_generations=4)
    backend, reports = check_against_textbook(table, scheduled, generations=6)
    sigmas = [0.1 / 2 ** (min(t, 4) / 2) for t in range(6)]
    assert [generation.sigma for generation in backend.generations] == pytest.approx(sigmas)
    assert [report.populations[0].generation.sigma for report in reports] == pytest.approx(sigmas)
    rates = [0.02 * 20 ** (-min(t, 4) / 4) for t in range(6)]
    assert [report.populations[0].learning_rate for report in reports] == pytest.approx(rates)


def test_every_level_has_its_own_rule(table):
    rules = (UpdateRule(optimizer=SGD(momentum=0.0)), UpdateRule(weight_decay=0.1))
    settings = replace(SETTINGS, updates=rules)
    state = formula_state(settings)
    _, (report,) = formula_run(table, 1, settings, state)
    moved = [np.linalg.norm(after.theta.astype(float) - before.theta)
             for before, after in zip(state.levels, report.state.levels, strict=True)]  # fmt: skip
    assert moved[0] == pytest.approx(0.02 * report.updates[0].gradient_norm, rel=1e-4)
    assert moved[1] == pytest.approx(0.02 * math.sqrt(5), rel=1e-3)  # the first step of Adam in every direction


def test_falls_have_their_price_in_the_level_of_its_rule(table):
    rule, price = UpdateRule(optimizer=SGD(momentum=0.0)), 0.7
    updates = [(rule, replace(rule, fall_price=each)) for each in (0.0, price)]
    free, priced = (formula_run(table, 1, replace(SETTINGS, updates=each))[1][0] for each in updates)
    before, after = (each.state.levels for each in (free, priced))
    assert after[0].theta.tolist() == before[0].theta.tolist()
    falls, drawn = np.arange(8).reshape(2, 4) % 3 > 0, free.populations[0]
    worth = -price * (falls - falls.mean()) / 2 * drawn.signs[:, :, 1]
    noise = np.array([table.slice(index, DIMS[1]) for index in drawn.noise_index[1].tolist()], dtype=float)
    assert after[1].theta - before[1].theta == pytest.approx(0.02 / 8 * worth.sum(axis=1) @ noise, abs=1e-6)


def test_the_state_alone_decides_how_a_run_goes_on(table):
    """Not threads, not what was before, and it stays as it was."""
    state = formula_state()
    for level in state.levels:
        level.theta.flags.writeable = False
    before = bits(state)
    _, whole = formula_run(table, 6, state=state)
    with ThreadPoolExecutor(3) as pool:
        _, rest = formula_run(table, 4, state=whole[1].state, pool=pool)
    assert bits(rest) == bits(whole[2:])
    assert bits(state) == before


@pytest.mark.parametrize("name", PERTURBATIONS)
@pytest.mark.parametrize("frozen", [0, 1])
def test_a_frozen_level_stays_as_it_is_in_every_respect(table, frozen, name):
    settings = replace(SETTINGS, learns=(frozen != 0, frozen != 1), perturbation=name)
    state = formula_state()
    for number, report in enumerate(formula_run(table, 3, settings, state)[1], start=1):
        assert bits(report.state.levels[frozen]) == bits(state.levels[frozen])  # statistics included
        learner = report.state.levels[1 - frozen]
        assert (learner.statistics.count, learner.optimizer.steps) == (number * 8 * EPISODES * 7, number)
        assert [np.isnan(update.gradient_norm) for update in report.updates] == [frozen == 0, frozen == 1]


def test_in_turns_a_level_rests_but_goes_on_observing(table):
    state = formula_state()
    for generation, report in enumerate(formula_run(table, 4, replace(SETTINGS, perturbation="one_to_many"), state)[1]):
        before, after = ([bits([own.theta, own.optimizer]) for own in each.levels] for each in (state, report.state))
        rests = [one == other for one, other in zip(before, after, strict=True)]
        assert rests == [generation % 2 == 1, generation % 2 == 0]
        assert {level.statistics.count for level in report.state.levels} == {(generation + 1) * 8 * EPISODES * 7}
        state = report.state


@given(start=positive, end=positive, generations=st.integers(1, 10_000), beyond=st.integers(0, 10**9))
def test_start_and_end_of_a_schedule_are_exact(start, end, generations, beyond):
    for name in ("sigma", "learning_rate"):
        settings = EvolutionSettings(**{name: start, f"{name}_end": end}, schedule_generations=generations)
        assert (settings.value(name, 0), settings.value(name, generations + beyond)) == (start, end)
