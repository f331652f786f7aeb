"""Novelty search: distances against a plain loop, and the published weights stepped by hand."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import UnknownNameError
from shes.es import novelty as module
from shes.es.novelty import NOVELTY_RULES, NSRA, AuthorsNSRA, NoveltyState, behaviour_distance, blend, extend, novelty

every_rule = pytest.mark.parametrize("name", NOVELTY_RULES)
positions = st.tuples(st.floats(-50, 50), st.floats(-50, 50))
places = st.lists(positions, max_size=12)


def _draw(size, episodes, archived, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(size, episodes, 2)) * 5, rng.normal(size=(archived, 2)) * 5


# ------------------------------------------------------------------------------------------------------- the distance


def test_a_distance_worked_out_by_hand():
    distance = behaviour_distance(np.array([[0.0, 0.0], [3.0, 4.0]]), np.array([[3.0, 4.0], [0.0, 1.0], [-6.0, 8.0]]))
    assert distance == pytest.approx(np.array([[5, 1, 10], [0, math.sqrt(18), math.sqrt(97)]]))


def test_novelty_worked_out_by_hand():
    # One member, two episodes. From (0, 0) the nearest two are 1 and 5 m away, from (0, 9) they are 8 and 9.
    behaviours = np.array([[[0.0, 0.0], [0.0, 9.0]]])
    archive = np.array([[0.0, 1.0], [3.0, -4.0], [9.0, 9.0], [80.0, 80.0]])
    assert novelty(behaviours, archive, 2) == pytest.approx([(3 + 8.5) / 2])
    assert novelty(behaviours, archive, 1) == pytest.approx([(1 + 8) / 2])


@given(
    behaviours=st.integers(1, 3).flatmap(
        lambda e: st.lists(st.lists(positions, min_size=e, max_size=e), min_size=1, max_size=6)
    ),
    archive=places,
    neighbours=st.integers(1, 15),
)
def test_novelty_is_that_of_a_plain_loop(behaviours, archive, neighbours):
    expected = []
    for member in behaviours:
        means = []
        for end in member:
            nearest = sorted(math.dist(end, place) for place in archive)[:neighbours]
            means.append(sum(nearest) / len(nearest) if nearest else 0.0)
        expected.append(sum(means) / len(means))
    result = novelty(np.array(behaviours), np.array(archive).reshape(-1, 2), neighbours)
    assert result == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_nothing_is_novel_beside_an_empty_archive():
    behaviours, _ = _draw(4, 2, 1)
    assert novelty(behaviours, np.zeros((0, 2)), 10).tolist() == [0] * 4


def test_an_archive_with_fewer_places_than_neighbours_counts_whole():
    behaviours, archive = _draw(5, 2, 3)
    assert novelty(behaviours, archive, 10).tobytes() == novelty(behaviours, archive, 3).tobytes()


@pytest.mark.parametrize("distances", [1, 7, 100, 1000, 1 << 20])
@pytest.mark.parametrize("archived", [1, 9, 10, 11, 300])
def test_the_memory_at_hand_does_not_change_a_bit(distances, archived, monkeypatch):
    behaviours, archive = _draw(23, 5, archived)
    expected = novelty(behaviours, archive, 10)
    monkeypatch.setattr(module, "_DISTANCES", distances)
    assert novelty(behaviours, archive, 10).tobytes() == expected.tobytes()


def test_the_other_members_do_not_change_a_bit():
    behaviours, archive = _draw(40, 3, 200)
    whole = novelty(behaviours, archive, 10)
    for i in range(0, 40, 7):
        assert novelty(behaviours[i : i + 1], archive, 10).tobytes() == whole[i : i + 1].tobytes()


@given(seed=st.integers(0, 1000), data=st.data())
def test_the_order_of_the_archive_does_not_change_a_bit(seed, data):
    behaviours, archive = _draw(6, 2, 25, seed)
    archive = np.round(archive)  # many ties
    order = np.array(data.draw(st.permutations(range(25))))
    expected = novelty(np.round(behaviours), archive, 7)
    assert novelty(np.round(behaviours), archive[order], 7).tobytes() == expected.tobytes()


def test_the_work_stays_in_little_memory():
    behaviours, archive = _draw(200, 5, 20_000)
    tracemalloc.start()
    novelty(behaviours, archive, 10)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6  # at once it would be 160 MB for the distances alone


def test_the_callers_arrays_stay_as_they_were():
    behaviours, archive = _draw(5, 2, 30)
    before = behaviours.tobytes(), archive.tobytes()
    novelty(behaviours, archive, 3)
    assert (behaviours.tobytes(), archive.tobytes()) == before


# -------------------------------------------------------------------------------------------------- archive and blend


def test_the_archive_grows_by_where_the_mean_policy_ended():
    start = NOVELTY_RULES.find("nsra")().start()
    once = extend(start, np.array([[1.0, 2.0], [3.0, 4.0]]))
    twice = extend(once, np.array([[5.0, 6.0]]))
    assert twice.archive.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert len(start.archive) == 0
    assert len(once.archive) == 2
    assert replace(twice, archive=start.archive) == replace(start, archive=start.archive)


def test_the_fitness_is_a_weighted_sum():
    returns, novelties = np.array([0.5, -0.5, 0.0]), np.array([-0.5, 0.25, 0.25])
    assert blend(returns, novelties, 1).tolist() == returns.tolist()
    assert blend(returns, novelties, 0).tolist() == novelties.tolist()
    assert blend(returns, novelties, 0.5).tolist() == [0, -0.125, 0.125]
    assert blend(returns, novelties, 0.8) == pytest.approx([0.3, -0.35, 0.05])


# ---------------------------------------------------------------------------------------------------------- the rules


def _weights(rule, mean_returns, population_returns=None):
    """Return the weight after each generation, and the last state."""
    state, weights = rule.start(), []
    for mean, population in zip(mean_returns, population_returns or mean_returns, strict=True):
        weight, best, stalled = rule.next(state, mean, population)
        state = replace(state, weight=weight, best_return=best, stalled=stalled)
        weights.append(weight)
    return weights, state


@every_rule
def test_a_rule_starts_with_nothing(name):
    rule = NOVELTY_RULES.find(name)()
    state = rule.start()
    assert (state.weight, state.best_return, state.stalled) == (rule.start_weight, -math.inf, 0)
    assert state.archive.shape == (0, 2)
    assert state.archive.dtype == np.float64


@every_rule
@given(returns=st.lists(st.integers(-5, 5), max_size=200))
def test_a_weight_stays_between_zero_and_one_and_the_best_is_the_best(name, returns):
    weights, state = _weights(NOVELTY_RULES.find(name)(), returns)
    assert all(0 <= weight <= 1 for weight in weights)
    assert state.best_return == max(returns, default=-math.inf)


@every_rule
def test_a_rule_changes_no_state(name):
    state = NoveltyState(archive=np.ones((2, 2)), weight=0.5, best_return=3.0, stalled=400)
    NOVELTY_RULES.find(name)().next(state, 9.0, 9.0)
    assert (state.weight, state.best_return, state.stalled) == (0.5, 3, 400)


@pytest.mark.parametrize(("name", "weight"), [("ns", 0), ("nsr", 0.5)])
def test_a_fixed_weight_stays_and_the_stall_is_counted(name, weight):
    weights, state = _weights(NOVELTY_RULES.find(name)(), [1, 5, 5, 2, 4])
    assert weights == [weight] * 5
    assert (state.best_return, state.stalled) == (5, 3)


def test_nsra_turns_to_novelty_after_fifty_generations_of_stall():
    # Generation 0 is a best. 1 to 49 stall; the 50th stall lowers the weight, as do the 100th and so on.
    weights, state = _weights(NSRA(), [1.0] * 151)
    assert weights == pytest.approx([1] * 50 + [0.95] * 50 + [0.9] * 50 + [0.85])
    assert state.stalled == 0


def test_nsra_turns_back_step_by_step_with_every_new_best():
    weights, state = _weights(NSRA(patience=2), [1, 0, 0, 0, 0, 1, 1, 2, 3, 3, 4, 5])
    assert weights == pytest.approx([1, 1, 0.95, 0.95, 0.9, 0.9, 0.85, 0.9, 0.95, 0.95, 1, 1])
    assert (state.best_return, state.stalled) == (5, 0)


def test_nsra_looks_at_the_mean_policy_only():
    assert _weights(NSRA(patience=1), [1, 2, 2], [9, 0, 99])[0] == pytest.approx([1, 1, 0.95])


def test_nsra_ends_at_novelty_alone():
    weights, _ = _weights(NSRA(patience=1), [0] * 40)
    assert weights[-1] == 0


def test_the_authors_rule_bears_a_stall_the_longer_the_more_novelty_weighs():
    # Borne are more than 10 generations at weight 1, so the 11th lowers it; at 0.95 more than 11, at 0.9 more than 12.
    weights, _ = _weights(AuthorsNSRA(), [1.0] * (1 + 11 + 12 + 13))
    assert weights == pytest.approx([1] * 11 + [0.95] * 12 + [0.9] * 13 + [0.85])


def test_the_authors_rule_goes_back_to_the_return_at_once():
    stall = [1.0] * 25
    weights, state = _weights(AuthorsNSRA(), [*stall, 2.0, 2.0])
    assert weights[-3:] == pytest.approx([0.9, 1, 1])
    assert (state.best_return, state.stalled) == (2, 1)


def test_the_authors_rule_looks_at_the_population_only():
    rule = AuthorsNSRA(patience=0)
    assert _weights(rule, [5, 9, 1, 99], [1, 2, 2, 2])[0] == pytest.approx([1, 1, 0.95, 0.95])


def test_the_authors_rule_has_a_floor():
    assert _weights(AuthorsNSRA(min_weight=0.8), [0] * 500)[0][-1] == pytest.approx(0.8)
    assert _weights(AuthorsNSRA(), [0] * 500)[0][-1] == 0


def _weight_schedule(w, fit, best_fit, tsb_fit):
    """Return what `weight_schedule` of the authors' Novelty.jl does, line by line."""
    tsb_fit += 1
    if fit > best_fit:
        best_fit, tsb_fit, w = fit, 0, 1.0
    if tsb_fit > 10 + (1 - w) * 20:
        w, tsb_fit = max(w - 0.05, 0.0), 0
    return w, best_fit, tsb_fit


@given(start=st.integers(-3, 3), jumps=st.lists(st.tuples(st.integers(1, 60), st.integers(-2, 2)), max_size=8))
def test_the_authors_rule_is_their_code(start, jumps):
    returns = [start]
    for length, change in jumps:
        returns += [returns[-1] + change] * length
    state, expected = AuthorsNSRA().start(), (1.0, -math.inf, 0)
    for value in returns:
        expected = _weight_schedule(expected[0], value, *expected[1:])
        weight, best, stalled = AuthorsNSRA().next(state, math.nan, value)
        state = replace(state, weight=weight, best_return=best, stalled=stalled)
        assert (weight, best, stalled) == expected


def test_an_unknown_rule_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"novelty rule 'nsrra'.*'nsra'\?.*--novelty"):
        NOVELTY_RULES.find("nsrra")()
