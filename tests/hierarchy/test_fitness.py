"""What a member is worth to each level: shaped returns, and novelty beside them, against plain arithmetic."""

import math
from dataclasses import replace

import numpy as np
import pytest

from shes.errors import PolicyError
from shes.es.level import UpdateRule
from shes.es.novelty import NOVELTY_RULES, NSR, NSRA, AuthorsNSRA, NoveltyState
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import CentredRanks, PairRanks, TopFraction, ZScore
from shes.hierarchy.fitness import advance_novelty, shaped_fitness
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


def _search(weight=0.3, places=7):
    archive = np.random.default_rng(9).uniform(-5, 5, (places, 2))
    return NoveltyState(archive=archive, weight=weight, best_return=0.0, stalled=0)


def _novelty(results, archive, neighbours):
    """Return the novelty of every member by loops: the mean over its episodes of the mean distance to the nearest."""
    found = []
    for ends in results.final_position.tolist():
        nearest = [sorted(math.dist(end, place) for place in archive.tolist())[:neighbours] for end in ends]
        found.append(sum(sum(each) / len(each) for each in nearest) / len(ends))
    return found


def test_without_novelty_a_level_is_worth_its_own_ranks():
    results = _results()
    shaped = shaped_fitness(results, _signs(), RANKS, None, 10)
    for level, worth in enumerate(shaped):
        assert worth == pytest.approx(centred_ranks(results.returns[level].mean(axis=1).tolist(), "average"))


def test_every_level_has_its_own_shaping():
    results = _results()
    rules = (UpdateRule(shaping=ZScore()), UpdateRule(shaping=TopFraction(top_fraction=0.25)))
    first, second = shaped_fitness(results, _signs(), rules, None, 10)
    fitness = results.returns.mean(axis=2)
    assert first == pytest.approx((fitness[0] - fitness[0].mean()) / fitness[0].std())
    assert (second > 0).tolist() == [f in sorted(fitness[1])[-2:] for f in fitness[1]]


def test_members_that_do_not_perturb_a_level_do_not_enter_its_ranks():
    results = _results()
    first, second = shaped_fitness(results, _signs("one_to_many_halves"), RANKS, None, 10)
    fitness = results.returns.mean(axis=2)
    assert first == pytest.approx(centred_ranks(fitness[0, :4].tolist(), "average"))
    assert second == pytest.approx(centred_ranks(fitness[1, 4:].tolist(), "average"))


@pytest.mark.parametrize(("generation", "sizes"), [(0, [8, 0]), (1, [0, 8])])
def test_a_level_that_nobody_perturbs_has_no_fitness(generation, sizes):
    shaped = shaped_fitness(_results(), _signs("one_to_many", generation=generation), RANKS, _search(), 3)
    assert [len(worth) for worth in shaped] == sizes


@pytest.mark.parametrize("neighbours", [1, 3, 7, 20])
@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
def test_the_first_level_is_worth_a_blend_of_return_and_novelty(weight, neighbours):
    results, search = _results(), _search(weight)
    first, second = shaped_fitness(results, _signs(), RANKS, search, neighbours)
    returns = [centred_ranks(results.returns[level].mean(axis=1).tolist(), "average") for level in (0, 1)]
    novel = centred_ranks(_novelty(results, search.archive, neighbours), "average")
    assert first == pytest.approx([weight * r + (1 - weight) * n for r, n in zip(returns[0], novel, strict=True)])
    assert second == pytest.approx(returns[1])


def test_novelty_is_shaped_as_the_return_is():
    results, search = _results(), _search(0.0)
    first, _ = shaped_fitness(results, _signs(), (UpdateRule(shaping=ZScore()),) * 2, search, 3)
    novel = np.array(_novelty(results, search.archive, 3))
    assert first == pytest.approx((novel - novel.mean()) / novel.std())


def test_in_halves_novelty_is_ranked_among_the_members_that_perturb_the_controller():
    results, search = _results(), _search(0.0)
    first, second = shaped_fitness(results, _signs("one_to_many_halves"), RANKS, search, 3)
    assert first == pytest.approx(centred_ranks(_novelty(results, search.archive, 3)[:4], "average"))
    assert second == pytest.approx(centred_ranks(results.returns[1, 4:].mean(axis=1).tolist(), "average"))


def test_a_policy_without_levels_above_it_can_search_for_novelty_too():
    results, search = _results(levels=1), _search(0.0)
    (worth,) = shaped_fitness(results, _signs(learns=(True,)), RANKS[:1], search, 3)
    assert worth == pytest.approx(centred_ranks(_novelty(results, search.archive, 3), "average"))


def _falls(results, seed=3):
    """Let some episodes fall."""
    falls = np.random.default_rng(seed).random(results.has_fallen.shape) < 0.4
    results.has_fallen[:] = falls
    return falls


@pytest.mark.parametrize("episodes", [1, 2])
def test_a_fall_takes_its_price_off_what_a_member_is_worth_and_the_sum_stays_zero(episodes):
    results = _results(episodes=episodes)
    share = [sum(own) / episodes for own in _falls(results).tolist()]
    plain = shaped_fitness(results, _signs(), RANKS, None, 10)
    priced = shaped_fitness(results, _signs(), (RANKS[0], UpdateRule(fall_price=2.5)), None, 10)
    assert priced[0].tobytes() == plain[0].tobytes()  # each level has its own price
    assert priced[1] == pytest.approx([w - 2.5 * (f - sum(share) / 8) for w, f in zip(plain[1], share, strict=True)])
    assert priced[1].sum() == pytest.approx(0, abs=1e-12)
    assert 0 < sum(share) < 8


def test_a_mirrored_pair_gains_the_price_where_one_side_falls_and_nothing_where_both_do():
    """Ranks alone cap what a fall costs: the price goes past them."""
    results = _results(levels=1)
    results.has_fallen[[1, 4, 5, 6]] = True
    signs, rule = np.tile(np.array([[[1], [-1]]], np.int8), (4, 1, 1)), UpdateRule(shaping=PairRanks())
    (plain,), (priced,) = (
        shaped_fitness(results, signs, (each,), None, 10) for each in (rule, replace(rule, fall_price=15.0))
    )
    gained = (priced[0::2] - priced[1::2]) - (plain[0::2] - plain[1::2])
    assert gained == pytest.approx([15, 0, 0, -15])


def test_falls_of_members_that_do_not_perturb_a_level_do_not_enter_its_mean():
    results, rules = _results(), (UpdateRule(fall_price=1.0),) * 2
    results.has_fallen[[0, 4, 5, 6]] = True
    plain = shaped_fitness(results, _signs("one_to_many_halves"), RANKS, None, 10)
    priced = shaped_fitness(results, _signs("one_to_many_halves"), rules, None, 10)
    assert priced[0] - plain[0] == pytest.approx([0.25 - 1, 0.25, 0.25, 0.25])
    assert priced[1] - plain[1] == pytest.approx([0.75 - 1, 0.75 - 1, 0.75 - 1, 0.75])


def test_where_all_fall_alike_the_price_changes_nothing():
    results = _results()
    results.has_terminated[:3] = True  # other ends than falls cost nothing
    for share in (0.0, 1.0):
        results.has_fallen[:] = share
        priced = shaped_fitness(results, _signs(), (UpdateRule(fall_price=9.0),) * 2, None, 10)
        for one, other in zip(priced, shaped_fitness(results, _signs(), RANKS, None, 10), strict=True):
            assert one.tobytes() == other.tobytes()


def test_a_fitness_that_is_not_finite_is_refused():
    results = _results()
    results.returns[1, 5, 0] = np.inf
    with pytest.raises(PolicyError, match="member 5 is inf"):
        shaped_fitness(results, _signs(), RANKS, None, 10)


def test_shaping_leaves_results_and_search_as_they_were():
    results, search = _results(), _search()
    before = [a.tobytes() for a in (results.returns, results.final_position, search.archive)]
    for array in (results.returns, results.final_position, search.archive):
        array.flags.writeable = False
    shaped_fitness(results, _signs(), (UpdateRule(shaping=CentredRanks(rank_ties="index")), UpdateRule()), search, 3)
    assert [a.tobytes() for a in (results.returns, results.final_position, search.archive)] == before


# How the search goes on -------------------------------------------------------------------------------------------


def test_without_novelty_there_is_nothing_to_go_on():
    assert advance_novelty(None, None, _results(9), 8) is None
    assert advance_novelty(None, NSR(), _results(9), 8) is None
    assert advance_novelty(_search(), None, _results(9), 8) is None


def test_the_archive_gets_the_ends_of_the_mean_policys_episodes_and_keeps_the_others():
    results, search = _results(9, episodes=3), _search(places=4)
    before = search.archive.copy()
    ahead = advance_novelty(search, NSR(), results, 8)
    assert np.array_equal(ahead.archive, np.concatenate([before, results.final_position[8]]))
    assert np.array_equal(search.archive, before)
    assert np.array_equal(advance_novelty(NSR().start(), NSR(), results, 8).archive, results.final_position[8])


@pytest.mark.parametrize("name", sorted(NOVELTY_RULES))
def test_the_rule_hears_the_environments_return_of_the_mean_policy_and_of_the_population_apart(name):
    rule, results, search = NOVELTY_RULES.find(name)(), _results(9), _search()
    ahead = advance_novelty(search, rule, results, 8)
    expected = rule.next(
        search, results.environment_returns[8].mean(), np.mean([results.environment_returns[m] for m in range(8)])
    )
    assert (ahead.weight, ahead.best_return, ahead.stalled) == expected


def test_an_episode_that_diverged_is_no_new_best_return():
    # Rewards are negative, and two episodes ended early: the mean policy's first, and one of the population.
    returns = np.array([[-5.0, -7.0]] * 7 + [[-1.0, -9.0], [-1.0, -6.0]])
    has_diverged = returns == -1
    results = _changed(_results(9), environment_returns=returns, has_diverged=has_diverged)
    search = replace(_search(0.5), best_return=-8.0)
    ahead = advance_novelty(search, NSRA(), results, 8)
    assert (ahead.best_return, ahead.weight) == (-7.5, 0.55)
    assert advance_novelty(search, AuthorsNSRA(), results, 8).best_return == (7 * -6 - 9) / 8


def test_the_weight_falls_where_the_mean_policy_stalls_and_the_authors_where_the_population_does():
    results = _changed(_results(9), environment_returns=np.array([[5.0]] * 8 + [[-5.0]]))
    search = replace(_search(0.5), best_return=0.0)
    assert advance_novelty(search, NSRA(patience=1), results, 8).weight == pytest.approx(0.45)
    assert advance_novelty(search, AuthorsNSRA(patience=0), results, 8).weight == 1
    turned = _changed(results, environment_returns=-results.environment_returns)
    assert advance_novelty(search, NSRA(patience=1), turned, 8).weight == pytest.approx(0.55)
    assert advance_novelty(search, AuthorsNSRA(patience=0, extra=0), turned, 8).weight == pytest.approx(0.45)
