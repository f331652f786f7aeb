"""Centred ranks: the properties that the update relies on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import PolicyError
from shes.es.ranking import TIES, centred_ranks
from tests.es import textbook

any_ties = st.sampled_from(TIES)
any_fitness = st.lists(st.floats(-1e300, 1e300), min_size=2, max_size=60)
# Few values: many ties, as on a sparse reward.
tied_fitness = st.lists(st.integers(-3, 3), min_size=2, max_size=60)
MONOTONE = (lambda x: 3 * x - 70, lambda x: x**3, lambda x: np.exp(x / 200), np.arctan, lambda x: -1 / (x + 5000))


@given(fitness=st.one_of(any_fitness, tied_fitness), ties=any_ties)
def test_ranks_sum_to_zero_within_minus_and_plus_a_half(fitness, ties):
    ranks = centred_ranks(np.array(fitness, dtype=float), ties)
    assert ranks.shape == (len(fitness),)
    assert abs(ranks.sum()) < 1e-12
    assert ranks.min() >= -0.5
    assert ranks.max() <= 0.5


@given(fitness=st.one_of(any_fitness, tied_fitness), ties=any_ties)
def test_ranks_are_those_of_counting(fitness, ties):
    assert centred_ranks(np.array(fitness, dtype=float), ties) == pytest.approx(textbook.centred_ranks(fitness, ties))


@given(fitness=st.one_of(any_fitness, tied_fitness), ties=any_ties)
def test_ranks_keep_the_order_of_fitness(fitness, ties):
    ranks = centred_ranks(np.array(fitness, dtype=float), ties)
    for mine, rank in zip(fitness, ranks, strict=True):
        for other, other_rank in zip(fitness, ranks, strict=True):
            if mine > other:
                assert rank > other_rank


@given(
    fitness=st.lists(st.integers(-1000, 1000), min_size=2, max_size=60),
    ties=any_ties,
    rescale=st.sampled_from(MONOTONE),
)
def test_ranks_do_not_change_under_a_monotone_transform(fitness, ties, rescale):
    values = np.array(fitness, dtype=float)
    assert np.array_equal(centred_ranks(rescale(values), ties), centred_ranks(values, ties))


@given(fitness=tied_fitness)
def test_equal_fitnesses_get_equal_average_ranks(fitness):
    ranks = centred_ranks(np.array(fitness, dtype=float))
    for value in set(fitness):
        assert len({rank for f, rank in zip(fitness, ranks, strict=True) if f == value}) == 1


@given(fitness=tied_fitness)
def test_ties_by_index_give_every_rank_once_and_a_later_place_the_higher_one(fitness):
    ranks = centred_ranks(np.array(fitness, dtype=float), "index")
    assert sorted(ranks) == pytest.approx(np.linspace(-0.5, 0.5, len(fitness)))
    for value in set(fitness):
        assert np.all(np.diff([rank for f, rank in zip(fitness, ranks, strict=True) if f == value]) > 0)


@given(fitness=tied_fitness, data=st.data())
def test_average_ranks_do_not_depend_on_storage_order(fitness, data):
    order = np.array(data.draw(st.permutations(range(len(fitness)))))
    values = np.array(fitness, dtype=float)
    assert np.array_equal(centred_ranks(values[order]), centred_ranks(values)[order])


def test_ranks_of_a_worked_example():
    fitness = np.array([3.0, 0.0, 7.0, 0.0, 0.0])
    assert centred_ranks(fitness) == pytest.approx([0.25, -0.25, 0.5, -0.25, -0.25])
    assert centred_ranks(fitness, "index") == pytest.approx([0.25, -0.5, 0.5, -0.25, 0.0])


def test_a_fitness_without_differences_is_worth_nothing():
    assert np.all(centred_ranks(np.full(12, 4.0)) == 0)


def test_a_population_of_one_has_rank_zero():
    assert centred_ranks(np.array([5.0])).tolist() == [0.0]


def test_the_callers_array_stays_as_it_was():
    fitness = np.array([3.0, 1.0, 2.0])
    centred_ranks(fitness)
    assert fitness.tolist() == [3, 1, 2]


@pytest.mark.parametrize(("value", "word"), [(np.nan, "nan"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_a_fitness_that_is_not_finite_is_refused_by_its_member(value, word):
    with pytest.raises(PolicyError, match=rf"fitness of member 2 is {word}, but every fitness must be finite"):
        centred_ranks(np.array([0.0, 1.0, value, value]))
