"""Fitness shaping: what every way of it owes the update, and each way's numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, PolicyError, UnknownNameError
from shes.es.ranking import TIES, centred_ranks
from shes.es.shaping import FITNESS_SHAPINGS, CentredRanks, PairRanks, TopFraction, ZScore
from shes.options import make

# Few values, so many ties, and all exact in binary after any shift and scale below.
fitnesses = st.lists(st.integers(-6, 6), min_size=2, max_size=50)
wide = st.lists(st.floats(-1e300, 1e300), min_size=2, max_size=40)
pairs = st.lists(st.tuples(st.integers(-6, 6), st.integers(-6, 6)), min_size=1, max_size=25)
every_name = pytest.mark.parametrize("name", [name for name in FITNESS_SHAPINGS if name != "pair_rank"])
"""Those of a whole population; ranks of pairs have tests of their own."""
every_ties = pytest.mark.parametrize("ties", TIES)


def _array(values):
    return np.array(values, dtype=float)


# ----------------------------------------------------------------------------------------- what every shaping owes


@every_name
@every_ties
@given(fitness=st.one_of(fitnesses, wide))
def test_shaped_fitness_sums_to_zero(name, ties, fitness):
    shaped = make(FITNESS_SHAPINGS, name, {"rank_ties": ties})(_array(fitness))
    assert shaped.shape == (len(fitness),)
    assert shaped.dtype == np.float64
    assert abs(shaped.sum()) < 1e-9


@every_name
@every_ties
@given(fitness=fitnesses, shift=st.integers(-1000, 1000), scale=st.sampled_from([0.125, 1, 3, 4096]))
def test_shift_and_scale_do_not_count(name, ties, fitness, shift, scale):
    shaping = make(FITNESS_SHAPINGS, name, {"rank_ties": ties})
    assert shaping(_array(fitness) * scale + shift) == pytest.approx(shaping(_array(fitness)), abs=1e-9)


@every_name
@every_ties
@given(fitness=st.one_of(fitnesses, wide))
def test_a_better_member_never_counts_less(name, ties, fitness):
    shaped = make(FITNESS_SHAPINGS, name, {"rank_ties": ties})(_array(fitness))
    for mine, value in zip(fitness, shaped, strict=True):
        assert all(value >= other for theirs, other in zip(fitness, shaped, strict=True) if mine > theirs)


@every_name
@given(fitness=fitnesses, data=st.data())
def test_without_ties_by_index_the_place_in_the_population_does_not_count(name, fitness, data):
    order = np.array(data.draw(st.permutations(range(len(fitness)))))
    shaping = FITNESS_SHAPINGS.find(name)()
    assert shaping(_array(fitness)[order]) == pytest.approx(shaping(_array(fitness))[order], abs=1e-12)


@every_name
@pytest.mark.parametrize("value", [0.0, 0.1, -7.3, 1e300, 5e-324])
@pytest.mark.parametrize("size", [2, 3, 10, 1000])
def test_equal_fitness_counts_nothing(name, value, size):
    assert np.all(FITNESS_SHAPINGS.find(name)()(np.full(size, value)) == 0)


@every_name
@every_ties
def test_a_population_of_one_counts_nothing(name, ties):
    assert make(FITNESS_SHAPINGS, name, {"rank_ties": ties})(_array([5])).tolist() == [0]


@every_name
@every_ties
def test_the_callers_array_stays_as_it_was(name, ties):
    fitness = _array([3, 1, 2, 2])
    shaped = make(FITNESS_SHAPINGS, name, {"rank_ties": ties})(fitness)
    shaped[:] = 99
    assert fitness.tolist() == [3, 1, 2, 2]


@every_name
@pytest.mark.parametrize(("value", "word"), [(np.nan, "nan"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_a_fitness_that_is_not_finite_is_refused_by_its_member(name, value, word):
    with pytest.raises(PolicyError, match=rf"fitness of member 2 is {word}, but every fitness must be finite"):
        FITNESS_SHAPINGS.find(name)()(_array([0, 1, value, value]))


# ------------------------------------------------------------------------------------------------------ the numbers


@given(pairs=pairs)
def test_pair_ranks_are_the_signed_ranks_of_scipy(pairs):
    from scipy.stats import rankdata

    difference = np.array([one - other for one, other in pairs])
    expected = np.sign(difference) * rankdata(np.abs(difference)) / len(pairs)
    shaped = PairRanks()(_array(pairs).ravel())
    assert shaped[0::2] - shaped[1::2] == pytest.approx(expected, abs=1e-12)
    assert shaped[0::2] == pytest.approx(-shaped[1::2])


def test_what_both_of_a_pair_have_in_common_does_not_count():
    base, shifts = _array([1, 2, 5, 3, 0, 0]), np.repeat([10.0, -40.0, 3.0], 2)
    assert PairRanks()(base + shifts).tolist() == PairRanks()(base).tolist()
    assert PairRanks()(base).tolist() == pytest.approx([-2 / 6, 2 / 6, 0.5, -0.5, 0, 0])


def test_pair_ranks_refuse_an_odd_population_and_a_fitness_that_is_not_finite():
    with pytest.raises(ConfigError, match=r"odd number of members, 3\. Set --mirrored pair"):
        PairRanks()(_array([1, 2, 3]))
    with pytest.raises(PolicyError, match="fitness of member 1 is nan"):
        PairRanks()(_array([1, np.nan]))


@every_ties
@given(fitness=fitnesses)
def test_centred_ranks_are_those_of_ranking(ties, fitness):
    expected = centred_ranks(_array(fitness), ties)
    assert CentredRanks(rank_ties=ties)(_array(fitness)).tobytes() == expected.tobytes()


def test_z_scores_of_a_worked_example():
    # Mean 5, squares of the deviations 9 1 1 1 0 0 4 16: variance 4.
    assert ZScore()(_array([2, 4, 4, 4, 5, 5, 7, 9])) == pytest.approx([-1.5, -0.5, -0.5, -0.5, 0, 0, 1, 2])


@given(fitness=st.lists(st.floats(-1e3, 1e3, width=32), min_size=2, max_size=40))
def test_z_scores_are_the_textbooks(fitness):
    mean = math.fsum(fitness) / len(fitness)
    std = math.sqrt(math.fsum((f - mean) ** 2 for f in fitness) / len(fitness))
    if std > 1e-6:
        assert ZScore()(_array(fitness)) == pytest.approx([(f - mean) / std for f in fitness], rel=1e-6, abs=1e-6)


def test_a_std_of_rounding_only_is_no_difference():
    summed = _array([0.1 + 0.2 + 0.3, 0.3 + 0.2 + 0.1, 0.6, 0.6])
    assert len(set(summed)) == 2  # the same return, added in another order
    assert np.all(ZScore()(summed) == 0)


def test_a_small_std_above_rounding_counts():
    assert ZScore()(_array([1, 1 + 1e-9])) == pytest.approx([-1, 1])


def test_fitness_as_large_or_small_as_a_float_has_z_scores():
    assert ZScore()(_array([-1.7e308, 1.7e308])) == pytest.approx([-1, 1])
    assert ZScore()(_array([0, 5e-324])) == pytest.approx([-1, 1])


def test_the_best_fifth_is_selected():
    fitness = _array([5, 9, 1, 3, 8, 2, 7, 0, 4, 6])
    assert TopFraction()(fitness) == pytest.approx([-0.2, 0.8, -0.2, -0.2, 0.8] + [-0.2] * 5)


def test_ties_across_the_border_share_the_places_or_the_later_ones_get_them():
    # Three places of six: one is the best's, two are left for the four that tie.
    fitness = _array([2, 2, 9, 2, 2, 1])
    assert TopFraction(top_fraction=0.5)(fitness) == pytest.approx([0, 0, 0.5, 0, 0, -0.5])
    assert TopFraction(top_fraction=0.5, rank_ties="index")(fitness) == pytest.approx([-0.5, -0.5, 0.5, 0.5, 0.5, -0.5])


def test_ties_by_index_select_those_with_the_highest_ranks_by_index():
    fitness = _array([0, 3, 3, 0, 3, 1, 3, 0])
    selected = TopFraction(top_fraction=0.3, rank_ties="index")(fitness) > 0
    assert np.flatnonzero(selected).tolist() == sorted(np.argsort(centred_ranks(fitness, "index"))[-3:].tolist())


@given(fitness=fitnesses, fraction=st.sampled_from([0.05, 0.2, 0.25, 0.5, 0.9]))
def test_selection_is_that_of_a_plain_loop(fitness, fraction):
    count = math.ceil(fraction * len(fitness))
    best_first = sorted(fitness, reverse=True)
    expected = []
    for mine in fitness:
        places = [i for i, other in enumerate(best_first) if other == mine]
        expected.append(sum(i < count for i in places) / len(places) - count / len(fitness))
    assert TopFraction(top_fraction=fraction)(_array(fitness)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("fraction", "size", "count"),
    [(0.2, 10, 2), (0.2, 11, 3), (0.07, 100, 7), (0.29, 100, 29), (0.001, 4, 1), (1e-12, 4, 1), (0.9, 5, 5)],
)
def test_the_number_selected_is_rounded_up_but_not_by_rounding_errors(fraction, size, count):
    assert TopFraction(top_fraction=fraction).num_selected(size) == count
    assert (TopFraction(top_fraction=fraction)(np.arange(float(size))) > 0).sum() == count % size


# ---------------------------------------------------------------------------------------------------------- the names


def test_a_name_gives_its_shaping_with_its_options():
    values = {"rank_ties": "index", "top_fraction": 0.4}
    assert make(FITNESS_SHAPINGS, "centred_rank", values) == CentredRanks(rank_ties="index")
    assert make(FITNESS_SHAPINGS, "z_score", values) == ZScore()
    assert make(FITNESS_SHAPINGS, "top_fraction", values) == TopFraction(top_fraction=0.4, rank_ties="index")


def test_an_unknown_shaping_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"fitness shaping 'zscore'.*'z_score'\?.*--fitness-shaping"):
        FITNESS_SHAPINGS.find("zscore")()


@pytest.mark.parametrize("fraction", [0, 1, -0.2, 1.5, math.nan])
def test_a_fraction_outside_zero_and_one_is_refused(fraction):
    with pytest.raises(ConfigError, match=rf"more than 0 and less than 1, got {fraction}\. Set --top-fraction"):
        make(FITNESS_SHAPINGS, "top_fraction", {"top_fraction": fraction})


@pytest.mark.parametrize("name", ["centred_rank", "top_fraction"])
def test_an_unknown_way_to_rank_ties_is_refused_with_the_nearest_name(name):
    with pytest.raises(UnknownNameError, match=r"'averge'.*Did you mean 'average'\?.*--rank-ties"):
        make(FITNESS_SHAPINGS, name, {"rank_ties": "averge"})
