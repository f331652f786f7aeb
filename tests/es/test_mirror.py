"""Mirrored sampling: the signs of a group, and the populations that groups can fill."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.es.mirror import MIRRORINGS, check_population, sign_matrix
from tests.es.textbook import SIGNS


@pytest.mark.parametrize(("mirrored", "num_levels"), SIGNS)
def test_the_signs_of_a_group_are_the_papers(mirrored, num_levels):
    signs = sign_matrix(mirrored, num_levels)
    assert signs.tolist() == [list(row) for row in SIGNS[mirrored, num_levels]]
    assert signs.dtype == np.int8


@given(num_levels=st.integers(1, 5))
def test_quad_columns_sum_to_zero_and_are_orthogonal(num_levels):
    signs = sign_matrix("quad", num_levels).astype(int)
    assert np.all(signs.sum(axis=0) == 0)
    assert np.array_equal(signs.T @ signs, len(signs) * np.eye(num_levels))


@given(num_levels=st.integers(1, 5))
def test_quad_has_every_combination_of_signs_once(num_levels):
    rows = [tuple(row) for row in sign_matrix("quad", num_levels).tolist()]
    assert len(rows) == 2**num_levels
    assert set(rows) == set(itertools.product((-1, 1), repeat=num_levels))


@given(num_levels=st.integers(1, 5))
def test_pair_members_are_opposites(num_levels):
    first, second = sign_matrix("pair", num_levels)
    assert np.all(first == 1)
    assert np.all(second == -1)


@given(mirrored=st.sampled_from(list(MIRRORINGS)), num_levels=st.integers(1, 3), groups=st.integers(1, 100))
def test_a_whole_number_of_groups_is_accepted(mirrored, num_levels, groups):
    members = len(sign_matrix(mirrored, num_levels))
    assert check_population(groups * members, mirrored, num_levels) == groups


@pytest.mark.parametrize(
    ("population", "mirrored", "levels", "message"),
    [
        (10, "quad", 2, r"multiple of 4, .* 'quad' mirroring when 2 levels are perturbed, got 10.* 8 or 12\."),
        (3, "quad", 2, r"got 3\. Set --population-size 4 or 8\."),
        (7, "pair", 2, r"multiple of 2, .*got 7\. Set --population-size 6 or 8\."),
        (0, "none", 1, r"positive multiple of 1, .* when 1 level is perturbed, got 0\. Set --population-size 1 or 2\."),
        (-4, "quad", 2, r"got -4\."),
    ],
)
def test_a_population_that_groups_do_not_fill_is_refused(population, mirrored, levels, message):
    with pytest.raises(ConfigError, match=message):
        check_population(population, mirrored, levels)


def test_an_unknown_mirroring_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"mirroring 'quads'.*'quad'\?.*Known: quad, none, pair\..*--mirrored"):
        sign_matrix("quads", 2)
