"""Centred ranks: the properties that the update relies on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import PolicyError
from shes.es.ranking import TIES, centred_ranks
from tests.es import textbook

any_ties = st.sampled_from(TIES)
# Few values give many ties, as with a sparse reward.
any_fitness = st.one_of(*(st.lists(values, min_size=2, max_size=60) for values in (
    st.floats(-1e300, 1e300), st.integers(-3, 3),
)))  # fmt: skip
MONOTONE = (lambda x: 3 * x - 70, lambda x: x**3, lambda x: np.exp(x / 200), np.arctan, lambda x: -1 / (x + 5000))


@given(fitness=any_fitness, ties=any_ties)
def test_ranks_equal_the_number_of_beaten_members(fitness, ties):
    values = np.array(fitness, dtype=float)
    values.flags.writeable = False
    ranks = centred_ranks(values, ties)
    assert ranks == pytest.approx(textbook.centred_ranks(fitness, ties))
    assert abs(ranks.sum()) < 1e-12


@given(fitness=st.lists(st.integers(-1000, 1000), min_size=2), ties=any_ties, rescale=st.sampled_from(MONOTONE))
def test_ranks_do_not_change_under_a_monotone_transform(fitness, ties, rescale):
    values = np.array(fitness, dtype=float)
    assert np.array_equal(centred_ranks(rescale(values), ties), centred_ranks(values, ties))


@given(fitness=any_fitness, data=st.data())
def test_average_ranks_do_not_depend_on_storage_order(fitness, data):
    order = np.array(data.draw(st.permutations(range(len(fitness)))))
    values = np.array(fitness, dtype=float)
    assert np.array_equal(centred_ranks(values[order]), centred_ranks(values)[order])


def test_ranks_of_a_worked_example():
    fitness = np.array([3.0, 0.0, 7.0, 0.0, 0.0])
    assert centred_ranks(fitness) == pytest.approx([0.25, -0.25, 0.5, -0.25, -0.25])
    assert centred_ranks(fitness, "index") == pytest.approx([0.25, -0.5, 0.5, -0.25, 0.0])


def test_members_that_are_equal_or_alone_have_rank_zero():
    assert not centred_ranks(np.full(12, 4.0)).any()
    assert centred_ranks(np.array([5.0])).tolist() == [0.0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_fitness_that_is_not_finite_is_refused(value):
    with pytest.raises(PolicyError, match=rf"fitness of member 2 is {value}, but every fitness must be finite"):
        centred_ranks(np.array([0.0, 1.0, value, value]))
