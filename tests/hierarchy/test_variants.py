"""Generations with schedules, with levels that rest, and with a search for novelty, on made-up fitness."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.novelty import NOVELTY_RULES, NS, NSR, NSRA
from shes.es.optimizers import OPTIMIZERS, SGD
from shes.es.perturbation import PERTURBATIONS, OneToMany, OneToManyHalves
from shes.es.shaping import ZScore
from shes.types import CONTROLLER, PRIMITIVE
from tests.es.textbook import TextbookES, centred_ranks
from tests.hierarchy.formula import (
    DIMS,
    EPISODES,
    SETTINGS,
    changing,
    check_against_textbook,
    end_of,
    formula,
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


# Novelty --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rule", "weight"), [(NS(), 0.0), (NSR(), 0.5), (NSRA(), 1.0)])
@pytest.mark.parametrize("perturbation", ["many_to_many", "one_to_many_halves"])
def test_the_controllers_fitness_is_a_blend_of_return_and_novelty(table, perturbation, rule, weight):
    settings = replace(SETTINGS, novelty=rule, novelty_neighbours=2, perturbation=PERTURBATIONS.find(perturbation)())
    backend, reports = formula_run(table, 4, settings)
    book = TextbookES(
        [level.theta for level in backend.generations[0].levels], mirrored="quad", sigma=0.1, rate=0.02,
        weight_decay=0.005, perturbation=perturbation,
    )  # fmt: skip
    archive, slots = [], range(EPISODES)
    for generation, report in zip(backend.generations, reports, strict=True):
        noise = noise_of(report, table)
        archive += end_of(generation.levels[CONTROLLER].theta, slots).tolist()  # this generation's are in it already
        novel = []
        for controller, _ in book.candidates(noise):
            nearest = [sorted(math.dist(end, place) for place in archive)[:2] for end in end_of(controller, slots)]
            novel.append(sum(sum(pair) / 2 for pair in nearest) / 3)
        perturbs = [[member[level][0] != 0 for member in book.members(noise)] for level in (0, 1)]
        returns, ranked_novelty = (
            [centred_ranks(list(itertools.compress(values, mask)), "average") for values, mask in zip(
                rows, perturbs, strict=True)]
            for rows in (report.results.fitness.tolist(), [novel, novel])
        )  # fmt: skip
        first = [weight * r + (1 - weight) * n for r, n in zip(returns[0], ranked_novelty[0], strict=True)]
        book.step([first, returns[1]], noise)
        for level, theta in zip(report.state.levels, book.thetas, strict=True):
            assert level.theta == pytest.approx(theta, abs=1e-5)


@pytest.mark.parametrize("name", sorted(NOVELTY_RULES))
def test_the_archive_grows_by_the_mean_policys_ends(table, name):
    settings = replace(SETTINGS, novelty=NOVELTY_RULES.find(name)())
    backend, reports = formula_run(table, 3, settings)
    for number, (generation, report) in enumerate(zip(backend.generations, reports, strict=True), start=1):
        archive = report.state.novelty.archive
        assert archive.shape == (number * EPISODES, 2)
        ends = end_of(generation.levels[CONTROLLER].theta, range(EPISODES))
        assert archive[-EPISODES:] == pytest.approx(ends, abs=1e-6)
        if number > 1:
            assert np.array_equal(archive[:-EPISODES], reports[number - 2].state.novelty.archive)


def test_the_archive_grows_with_the_schedule_of_episodes(table):
    _, reports = formula_run(table, 4, replace(SCHEDULED, novelty=NSR()))
    assert [len(report.state.novelty.archive) for report in reports] == [1, 3, 6, 10]


def test_the_mean_policys_episodes_are_steps_but_no_members(table):
    settings = replace(SETTINGS, novelty=NSR())
    (_, plain), (backend, searching) = (formula_run(table, 2, each) for each in (SETTINGS, settings))
    steps = sum(100 + slot for slot in range(EPISODES))
    assert [report.state.env_steps for report in searching] == [9 * steps, 18 * steps]
    for tasks in backend.tasks:
        assert {task.member for task in tasks} == set(range(9))
        assert {task.signs for task in tasks if task.member == 8} == {((0, 0),)}
        assert sum(len(task.seeds) for task in tasks if task.member == 8) == EPISODES
    for one, other in zip(plain, searching, strict=True):
        assert other.results.returns.shape == (2, 8, EPISODES)
        assert other.results.steps.sum() == 8 * steps
        for before, after in zip(one.state.levels, other.state.levels, strict=True):
            assert after.statistics.count == before.statistics.count
    # What the population does, and what the primitive is worth, is as without a search while policies are the same.
    assert searching[0].results.returns.tobytes() == plain[0].results.returns.tobytes()
    assert same_level(searching[0].state.levels[PRIMITIVE], plain[0].state.levels[PRIMITIVE])
    assert not same_level(searching[0].state.levels[CONTROLLER], plain[0].state.levels[CONTROLLER])


def test_the_rule_of_novelty_hears_returns_of_the_environment(table):
    _, reports = formula_run(table, 2, replace(SETTINGS, novelty=NSRA(patience=1)))
    state = formula_state(replace(SETTINGS, novelty=NSRA()))
    best = -math.inf
    for report in reports:
        controller, primitive = (level.theta for level in state.levels)
        mean_return = formula(controller, primitive)[0] + 5
        best = max(best, mean_return)
        assert report.state.novelty.best_return == pytest.approx(best, rel=1e-5)
        state = report.state
