"""Generations with schedules, and with levels that rest, on made-up fitness."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import SGD
from shes.es.perturbation import PERTURBATIONS, OneToMany, OneToManyHalves
from shes.types import CONTROLLER, PRIMITIVE
from tests.hierarchy.formula import (
    DIMS,
    EPISODES,
    SETTINGS,
    changing,
    check_against_textbook,
    formula_run,
    formula_state,
    same_level,
)


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


# Schedules ------------------------------------------------------------------------------------------------------------


SCHEDULED = replace(
    SETTINGS,
    sigma=changing(0.1, 0.02, 4),
    learning_rate=changing(0.02, 0.001, 3),
)


def test_sigma_and_learning_rate_are_those_of_their_schedules(table):
    backend, reports = formula_run(table, 6, SCHEDULED)
    sigmas = [0.1 * 5 ** (-min(t, 4) / 4) for t in range(6)]
    rates = [0.02 * 20 ** (-min(t, 3) / 3) for t in range(6)]
    told = [report.population.work.generation.sigma for report in reports]
    assert told == pytest.approx(sigmas)
    assert [report.population.learning_rate for report in reports] == pytest.approx(rates)
    assert [generation.sigma for generation in backend.generations] == [
        report.population.work.generation.sigma for report in reports
    ]


def test_generations_with_schedules_are_the_textbooks(table):
    check_against_textbook(table, SCHEDULED, generations=6)


def test_the_learning_rate_of_a_schedule_is_that_of_the_step(table):
    rule = UpdateRule(optimizer=SGD(momentum=0.0))
    settings = replace(SETTINGS, updates=(rule, rule), learning_rate=changing(0.5, 0.08, 2))
    state = formula_state(settings)
    _, reports = formula_run(table, 3, settings, state=state)
    for report, rate in zip(reports, (0.5, 0.2, 0.08), strict=True):
        for before, update in zip(state.levels, report.updates, strict=True):
            moved = np.linalg.norm(update.level.theta.astype(float) - before.theta)
            assert moved == pytest.approx(rate * update.gradient_norm, rel=1e-4)
        state = report.state


# Levels that rest -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(PERTURBATIONS))
@pytest.mark.parametrize("frozen", [CONTROLLER, PRIMITIVE])
def test_a_frozen_level_stays_as_it_is_in_every_respect(table, frozen, name):
    learns = tuple(level != frozen for level in (0, 1))
    settings = replace(SETTINGS, learns=learns, perturbation=PERTURBATIONS.find(name)())
    state = formula_state()
    first = state.levels[frozen]
    first = replace(first, statistics=first.statistics.merge(4, np.ones(DIMS[frozen]), 9 * np.ones(DIMS[frozen])))
    state = replace(state, levels=tuple(first if i == frozen else level for i, level in enumerate(state.levels)))
    backend, reports = formula_run(table, 3, settings, state=state)
    for report, tasks in zip(reports, backend.tasks, strict=True):
        assert {task.signs[0][frozen] for task in tasks} == {0}
        assert {abs(task.signs[0][1 - frozen]) for task in tasks} == {1}
        frozen_level, learner = report.state.levels[frozen], report.state.levels[1 - frozen]
        assert same_level(frozen_level, first)
        assert frozen_level.statistics is first.statistics  # no new observations
        assert learner.statistics.count == report.state.generation * 8 * EPISODES * 7
        assert learner.optimizer.steps == report.state.generation
        about = report.updates[frozen]
        assert np.isnan([about.gradient_norm, about.halves_cosine, about.update_ratio]).all()
        about = report.updates[1 - frozen]
        assert np.isfinite([about.gradient_norm, about.halves_cosine, about.update_ratio]).all()
    for old, new in itertools.pairwise(backend.generations):
        assert np.array_equal(old.levels[frozen].mean, new.levels[frozen].mean)


def test_in_turns_a_level_rests_but_goes_on_observing(table):
    settings = replace(SETTINGS, perturbation=OneToMany())
    state = formula_state()
    backend, reports = formula_run(table, 4, settings, state=state)
    for generation, (report, tasks) in enumerate(zip(reports, backend.tasks, strict=True)):
        turn = generation % 2
        assert {task.signs[0][turn] for task in tasks} == {1, -1}
        assert {task.signs[0][1 - turn] for task in tasks} == {0}
        assert same_level(report.state.levels[1 - turn], state.levels[1 - turn])
        assert not same_level(report.state.levels[turn], state.levels[turn])
        assert [np.isnan(update.gradient_norm) for update in report.updates] == [turn == 1, turn == 0]
        for level in report.state.levels:
            assert level.statistics.count == (generation + 1) * 8 * EPISODES * 7
        state = report.state
    assert [level.optimizer.steps for level in state.levels] == [2, 2]


def test_in_halves_both_levels_learn_in_every_generation(table):
    backend, reports = formula_run(table, 2, replace(SETTINGS, perturbation=OneToManyHalves()))
    for number, (report, tasks) in enumerate(zip(reports, backend.tasks, strict=True), start=1):
        signs = {task.member: task.signs[0] for task in tasks}
        assert [signs[m] for m in range(8)] == [(1, 0), (-1, 0)] * 2 + [(0, 1), (0, -1)] * 2
        assert [level.optimizer.steps for level in report.state.levels] == [number, number]
        assert np.isfinite([update.gradient_norm for update in report.updates]).all()


def test_every_level_has_its_own_rule(table):
    rules = (UpdateRule(optimizer=SGD(momentum=0.0)), UpdateRule(weight_decay=0.1))
    settings = replace(SETTINGS, updates=rules)
    state = formula_state(settings)
    _, (report,) = formula_run(table, 1, settings, state=state)
    moved = [
        np.linalg.norm(after.theta.astype(float) - before.theta)
        for before, after in zip(state.levels, report.state.levels, strict=True)
    ]
    assert moved[0] == pytest.approx(0.02 * report.updates[0].gradient_norm, rel=1e-4)
    assert moved[1] == pytest.approx(0.02 * math.sqrt(5), rel=1e-3)  # the first step of Adam in every direction
