"""Generations with schedules, and with levels that rest, on made-up fitness."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS, SGD
from shes.es.perturbation import PERTURBATIONS, OneToMany, OneToManyHalves
from shes.es.shaping import ZScore
from shes.types import CONTROLLER, PRIMITIVE
from tests.hierarchy.formula import (
    DIMS,
    EPISODES,
    SETTINGS,
    changing,
    check_against_textbook,
    formula_run,
    formula_state,
    noise_of,
    same_level,
)


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


# Schedules ------------------------------------------------------------------------------------------------------------


SCHEDULED = replace(
    SETTINGS,
    sigma=changing(0.1, 0.02, 4),
    learning_rate=changing(0.02, 0.001, 3, "cosine"),
    episodes_per_policy=changing(1, 4, 3),
)


def test_sigma_and_learning_rate_are_those_of_their_schedules(table):
    backend, reports = formula_run(table, 6, SCHEDULED)
    sigmas = [0.1, 0.08, 0.06, 0.04, 0.02, 0.02]
    rates = [0.001 + 0.019 * (1 + math.cos(math.pi * min(t, 3) / 3)) / 2 for t in range(6)]
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
    settings = replace(SETTINGS, updates=(rule, rule), learning_rate=changing(0.5, 0.1, 2, "linear"))
    state = formula_state(settings)
    _, reports = formula_run(table, 3, settings, state=state)
    for report, rate in zip(reports, (0.5, 0.3, 0.1), strict=True):
        for before, update in zip(state.levels, report.updates, strict=True):
            moved = np.linalg.norm(update.level.theta.astype(float) - before.theta)
            assert moved == pytest.approx(rate * update.gradient_norm, rel=1e-4)
        state = report.state


def test_the_episodes_of_a_schedule_are_whole_and_one_at_least(table):
    settings = replace(SETTINGS, episodes_per_policy=changing(4, 0, 8))
    assert [settings.episodes(t) for t in (0, 1, 2, 6, 7, 8, 99)] == [4, 4, 3, 1, 1, 1, 1]  # 3.5 is rounded to even
    backend, reports = formula_run(table, 5, SCHEDULED)
    assert [generation.episodes_per_policy for generation in backend.generations] == [1, 2, 3, 4, 4]
    steps = 0
    for report, tasks, episodes in zip(reports, backend.tasks, (1, 2, 3, 4, 4), strict=True):
        assert report.results.returns.shape == (2, 8, episodes)
        assert len({(task.member, slot) for task in tasks for slot in task.slots}) == 8 * episodes
        steps += 8 * sum(100 + slot for slot in range(episodes))
        assert report.state.env_steps == steps


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
    rules = (UpdateRule(optimizer=OPTIMIZERS.find("clipup")()), UpdateRule(weight_decay=0.1, shaping=ZScore()))
    settings = replace(SETTINGS, updates=rules)
    state = formula_state(settings)
    _, (report,) = formula_run(table, 1, settings, state=state)
    moved = [
        np.linalg.norm(after.theta.astype(float) - before.theta)
        for before, after in zip(state.levels, report.state.levels, strict=True)
    ]
    assert moved[0] == pytest.approx(0.02, rel=1e-5)  # the first step of ClipUp is as long as the learning rate
    assert moved[1] == pytest.approx(0.02 * math.sqrt(5), rel=1e-3)  # and that of Adam so in every direction
    fitness = report.results.fitness[1]
    scores = (fitness - fitness.mean()) / fitness.std()
    gradient = sum(
        score * sign * noise.astype(float)
        for score, (sign, noise) in zip(
            scores, [(sign, noise) for noise in noise_of(report, table)[1] for sign in (1, -1, 1, -1)], strict=True
        )
    )
    assert report.updates[1].gradient_norm == pytest.approx(np.linalg.norm(gradient) / 8, rel=1e-4)
