"""`evolve` on made-up fitness: the textbook's iterates, and tasks that say what they should.

Its variants are in `hierarchy/test_variants.py`; the same bits on any workers, in `hierarchy/test_same_numbers.py`.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from shes.errors import ConfigError
from shes.es.level import UpdateRule
from shes.es.noise import NoiseTable
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import CentredRanks
from shes.types import CONTROLLER, PRIMITIVE
from tests.es.textbook import TextbookES
from tests.hierarchy.formula import (
    DIMS,
    EPISODES,
    SETTINGS,
    check_against_textbook,
    constant,
    formula,
    formula_run,
    noise_of,
    start_state,
    state_bits,
)


@pytest.fixture(scope="module")
def table():
    return NoiseTable.open(50_000)


@pytest.mark.parametrize("ties", ["average", "index"])
@pytest.mark.parametrize(("mirrored", "members"), [("quad", 4), ("pair", 2), ("none", 1)])
def test_generations_are_the_textbooks(table, mirrored, members, ties):
    rule = UpdateRule(weight_decay=0.005, shaping=CentredRanks(rank_ties=ties))
    settings = replace(SETTINGS, population_size=12, mirrored=mirrored, updates=(rule, rule))
    for report in check_against_textbook(table, settings, ties=ties):
        assert report.population.work.noise_index.shape == (2, 12 // members)


@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("learns", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("name", sorted(PERTURBATIONS))
def test_generations_are_the_textbooks_whichever_level_is_perturbed(table, name, learns, mirrored):
    settings = replace(
        SETTINGS, population_size=12, mirrored=mirrored, perturbation=PERTURBATIONS.find(name)(), learns=learns
    )
    check_against_textbook(table, settings, perturbation=name)


def test_both_levels_learn(table):
    settings = replace(
        SETTINGS,
        population_size=24,
        updates=(UpdateRule(),) * 2,
        learning_rate=constant(0.08),
        episodes_per_policy=constant(1),
    )
    _, reports = formula_run(table, 100, settings)
    assert reports[-1].state.levels[PRIMITIVE].theta == pytest.approx(np.full(5, 2), abs=0.15)
    assert reports[-1].state.levels[CONTROLLER].theta == pytest.approx(np.full(3, 3), abs=0.2)


def test_a_run_that_stopped_goes_on_as_if_it_had_not(table):
    _, whole = formula_run(table, 6)
    _, half = formula_run(table, 2)
    _, rest = formula_run(table, 4, state=half[-1].state)
    assert state_bits(rest[-1].state) == state_bits(whole[-1].state)
    assert rest[-1].state.generation == 6


def test_threads_for_the_gradient_change_no_bit(table):
    with ThreadPoolExecutor(3) as pool:
        _, threaded = formula_run(table, 3, pool=pool)
    assert state_bits(threaded[-1].state) == state_bits(formula_run(table, 3)[1][-1].state)


def test_the_state_before_stays_as_it_was(table):
    state = start_state([np.ones(dim, np.float32) for dim in DIMS], DIMS)
    before = state_bits(state)
    formula_run(table, 2, state=state)
    assert state_bits(state) == before


def test_workers_get_the_mean_policies_with_the_normalisation_of_the_generation(table):
    backend, reports = formula_run(table, 2)
    first, second = backend.generations
    assert not first.is_evaluation
    assert first.sigma == 0.1
    for old, new, level, dim in zip(first.levels, second.levels, reports[0].state.levels, DIMS, strict=True):
        assert old.inverse_std.tolist() == [1] * dim  # nothing observed yet
        assert new.theta.tobytes() == level.theta.tobytes()
        assert new.mean == pytest.approx(np.full(dim, 2))  # 14 / 7
        assert 1 / new.inverse_std == pytest.approx(np.full(dim, 5**0.5))  # 63 / 7 - 4


def _whole_tasks(tasks):
    """Return seeds and flags by member, whether its episodes came together or alone."""
    seeds, records = {}, {}
    assert [(task.member, task.slots[0]) for task in tasks] == sorted((task.member, task.slots[0]) for task in tasks)
    for task in tasks:
        seeds.setdefault(task.member, []).extend(task.seeds)
        records.setdefault(task.member, set()).add(task.records_statistics)
    assert all(len(found) == EPISODES for found in seeds.values())
    return [tuple(seeds[m]) for m in sorted(seeds)], [records[m].pop() for m in sorted(records)]


def test_with_common_random_numbers_the_members_of_a_group_share_their_seeds(table):
    backend, _ = formula_run(table, 3, replace(SETTINGS, population_size=16))
    groups = []
    for tasks in backend.tasks:
        seeds, _ = _whole_tasks(tasks)
        assert len(seeds) == 16
        for start in range(0, 16, 4):
            assert len(set(seeds[start : start + 4])) == 1
            groups.append(seeds[start])
    distinct = {seed for group in groups for seed in group}
    assert len(distinct) == 3 * 4 * EPISODES  # other seeds in every group, episode and generation


def test_without_common_random_numbers_all_seeds_differ(table):
    settings = replace(SETTINGS, population_size=16, common_random_numbers="off")
    backend, _ = formula_run(table, 3, settings)
    seeds = [seed for tasks in backend.tasks for member in _whole_tasks(tasks)[0] for seed in member]
    assert len(set(seeds)) == len(seeds) == 3 * 16 * EPISODES


def test_a_population_may_share_its_episodes(table):
    settings = replace(SETTINGS, population_size=16, common_random_numbers="population")
    backend, _ = formula_run(table, 3, settings)
    shared = [set(_whole_tasks(tasks)[0]) for tasks in backend.tasks]
    assert [len(seeds) for seeds in shared] == [1, 1, 1]
    assert len({seed for (member,) in shared for seed in member}) == 3 * EPISODES


def test_common_random_numbers_change_no_noise(table):
    _, on = formula_run(table, 1)
    _, off = formula_run(table, 1, replace(SETTINGS, common_random_numbers="off"))
    assert np.array_equal(on[0].population.work.noise_index, off[0].population.work.noise_index)


def test_tasks_say_who_perturbs_how(table):
    backend, reports = formula_run(table, 1)
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    members = {task.member: task for task in backend.tasks[0]}
    assert sorted(members) == list(range(8))
    for member, task in members.items():
        assert task.signs == (signs[member % 4],)
        assert task.noise_index == tuple(reports[0].population.work.noise_index[:, member // 4].tolist())


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0])
def test_a_share_of_the_groups_enters_the_statistics(table, fraction):
    settings = replace(SETTINGS, population_size=80, statistics_fraction=fraction)
    backend, reports = formula_run(table, 2, settings)
    recorded = 0
    for tasks in backend.tasks:
        _, flags = _whole_tasks(tasks)
        groups = [set(flags[start : start + 4]) for start in range(0, 80, 4)]
        assert all(len(group) == 1 for group in groups)
        recorded += sum(flags)
    assert fraction * 160 == pytest.approx(recorded, abs=48 if fraction == 0.5 else 0)
    for level in reports[-1].state.levels:
        assert level.statistics.count == recorded * EPISODES * 7


def test_environment_steps_add_up(table):
    _, reports = formula_run(table, 3)
    assert [report.state.env_steps for report in reports] == [8 * (100 + 101 + 102) * k for k in (1, 2, 3)]
    assert [report.state.generation for report in reports] == [1, 2, 3]


def test_results_stand_by_member_and_episode(table):
    _, reports = formula_run(table, 1)
    results = reports[0].results
    assert results.returns.shape == (2, 8, EPISODES)
    assert results.score.tolist() == [[-1, 0, 1]] * 8
    assert results.steps.tolist() == [[100, 101, 102]] * 8
    assert results.has_terminated.tolist() == [[False, False, True]] * 8
    assert results.goals_reached.tolist() == [[0, 1, 2]] * 8
    assert results.environment_returns == pytest.approx(results.returns[CONTROLLER] + 5)
    assert results.final_position.shape == (8, EPISODES, 2)
    assert not results.has_diverged.any()


def test_to_diverge_does_not_pay(table):
    """Two episodes that end by breaking the physics are paid a million; they count as the worst of the others."""
    diverging = [(2, 0), (7, 1)]
    backend, (report,) = formula_run(table, 1, diverging=diverging)
    book = TextbookES(
        [level.theta for level in backend.generations[0].levels], mirrored="quad", sigma=0.1, rate=0.02,
        weight_decay=0.005,
    )  # fmt: skip
    noise = noise_of(report, table)
    returns = np.array([formula(*pair) for pair in book.candidates(noise)]).T[:, :, None] + np.array([-1, 0, 1])
    for level in returns:
        worst = min(level[m, e] for m in range(8) for e in range(3) if (m, e) not in diverging)
        for place in diverging:
            level[place] = worst
    book.update(returns.mean(axis=2).tolist(), noise)
    for level, theta in zip(report.state.levels, book.thetas, strict=True):
        assert level.theta == pytest.approx(theta, abs=1e-5)


def test_a_population_that_groups_do_not_fill_is_refused(table):
    with pytest.raises(ConfigError, match=r"multiple of 4, .*got 10"):
        formula_run(table, 1, replace(SETTINGS, population_size=10))


def test_another_seed_has_other_noise_and_other_episodes(table):
    state = start_state([np.ones(dim, np.float32) for dim in DIMS], DIMS)
    (backend, reports), (other_backend, other) = (
        formula_run(table, 1, state=replace(state, seed=seed)) for seed in (3, 4)
    )
    assert not set(reports[0].population.work.noise_index.ravel()) & set(other[0].population.work.noise_index.ravel())
    seeds, other_seeds = ({seed for task in b.tasks[0] for seed in task.seeds} for b in (backend, other_backend))
    assert not seeds & other_seeds
