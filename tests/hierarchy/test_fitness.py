"""What a member is worth to each level: shaped returns, against plain arithmetic."""

from dataclasses import replace

import numpy as np
import pytest

from shes.errors import PolicyError
from shes.es.level import UpdateRule
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import CentredRanks, PairRanks
from shes.hierarchy.fitness import shaped_fitness
from shes.hierarchy.results import PopulationResults
from tests.es.textbook import centred_ranks

RANKS = (UpdateRule(), UpdateRule())


def _changed(results, **quantities):
    changed = replace(results, outcomes=results.outcomes.copy())
    for name, values in quantities.items():
        changed.outcomes[name] = values
    return changed


def _results(members=8, episodes=2, seed=0, levels=2):
    rng = np.random.default_rng(seed)
    results = PopulationResults.empty(levels, members, episodes)
    results.returns[:] = rng.normal(size=results.returns.shape)
    results.final_position[:] = rng.uniform(-5, 5, results.final_position.shape)
    results.environment_returns[:] = rng.normal(size=results.environment_returns.shape)
    return results


def _signs(perturbation="many_to_many", population=8, learns=(True, True), generation=0):
    return PERTURBATIONS.find(perturbation)().signs(generation, population, "quad", learns)


def test_a_level_is_worth_its_own_ranks():
    results = _results()
    shaped = shaped_fitness(results, _signs(), RANKS)
    for level, worth in enumerate(shaped):
        assert worth == pytest.approx(centred_ranks(results.returns[level].mean(axis=1).tolist(), "average"))


def test_every_level_has_its_own_shaping():
    results = _results()
    rules = (UpdateRule(shaping=PairRanks()), UpdateRule(shaping=CentredRanks()))
    fitness = results.returns.mean(axis=2)
    for shaped, rule, own in zip(shaped_fitness(results, _signs(), rules), rules, fitness, strict=True):
        assert shaped == pytest.approx(rule.shaping(own))


def test_members_that_do_not_perturb_a_level_do_not_enter_its_ranks():
    results = _results()
    first, second = shaped_fitness(results, _signs("one_to_many_halves"), RANKS)
    fitness = results.returns.mean(axis=2)
    assert first == pytest.approx(centred_ranks(fitness[0, :4].tolist(), "average"))
    assert second == pytest.approx(centred_ranks(fitness[1, 4:].tolist(), "average"))


@pytest.mark.parametrize(("generation", "sizes"), [(0, [8, 0]), (1, [0, 8])])
def test_a_level_that_nobody_perturbs_has_no_fitness(generation, sizes):
    shaped = shaped_fitness(_results(), _signs("one_to_many", generation=generation), RANKS)
    assert [len(worth) for worth in shaped] == sizes


def _falls(results, seed=3):
    """Let some episodes fall."""
    falls = np.random.default_rng(seed).random(results.has_fallen.shape) < 0.4
    results.has_fallen[:] = falls
    return falls


@pytest.mark.parametrize("episodes", [1, 2])
def test_a_fall_takes_its_price_off_what_a_member_is_worth_and_the_sum_stays_zero(episodes):
    results = _results(episodes=episodes)
    share = [sum(own) / episodes for own in _falls(results).tolist()]
    plain = shaped_fitness(results, _signs(), RANKS)
    priced = shaped_fitness(results, _signs(), (RANKS[0], UpdateRule(fall_price=2.5)))
    assert priced[0].tobytes() == plain[0].tobytes()  # each level has its own price
    assert priced[1] == pytest.approx([w - 2.5 * (f - sum(share) / 8) for w, f in zip(plain[1], share, strict=True)])
    assert priced[1].sum() == pytest.approx(0, abs=1e-12)
    assert 0 < sum(share) < 8


def test_a_mirrored_pair_gains_the_price_where_one_side_falls_and_nothing_where_both_do():
    """Ranks alone cap what a fall costs: the price goes past them."""
    results = _results(levels=1)
    results.has_fallen[[1, 4, 5, 6]] = True
    signs, rule = np.tile(np.array([[[1], [-1]]], np.int8), (4, 1, 1)), UpdateRule(shaping=PairRanks())
    (plain,), (priced,) = (shaped_fitness(results, signs, (each,)) for each in (rule, replace(rule, fall_price=15.0)))
    gained = (priced[0::2] - priced[1::2]) - (plain[0::2] - plain[1::2])
    assert gained == pytest.approx([15, 0, 0, -15])


def test_falls_of_members_that_do_not_perturb_a_level_do_not_enter_its_mean():
    results, rules = _results(), (UpdateRule(fall_price=1.0),) * 2
    results.has_fallen[[0, 4, 5, 6]] = True
    plain = shaped_fitness(results, _signs("one_to_many_halves"), RANKS)
    priced = shaped_fitness(results, _signs("one_to_many_halves"), rules)
    assert priced[0] - plain[0] == pytest.approx([0.25 - 1, 0.25, 0.25, 0.25])
    assert priced[1] - plain[1] == pytest.approx([0.75 - 1, 0.75 - 1, 0.75 - 1, 0.75])


def test_where_all_fall_alike_the_price_changes_nothing():
    results = _results()
    results.has_terminated[:3] = True  # other ends than falls cost nothing
    for share in (0.0, 1.0):
        results.has_fallen[:] = share
        priced = shaped_fitness(results, _signs(), (UpdateRule(fall_price=9.0),) * 2)
        for one, other in zip(priced, shaped_fitness(results, _signs(), RANKS), strict=True):
            assert one.tobytes() == other.tobytes()


def test_a_fitness_that_is_not_finite_is_refused():
    results = _results()
    results.returns[1, 5, 0] = np.inf
    with pytest.raises(PolicyError, match="member 5 is inf"):
        shaped_fitness(results, _signs(), RANKS)


def test_shaping_leaves_results_as_they_were():
    results = _results()
    before = results.returns.tobytes()
    results.returns.flags.writeable = False
    shaped_fitness(results, _signs(), (UpdateRule(shaping=CentredRanks(rank_ties="index")), UpdateRule()))
    assert results.returns.tobytes() == before
