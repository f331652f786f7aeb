"""The signs of a population's members, and the sizes that it may have."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError
from shes.es.perturbation import MIRRORINGS, PERTURBATIONS, check_population_size, member_signs

BOTH, CONTROLLER_ALONE = (True, True), (True, False)


def signs_of(name, population, mirrored="quad", learns=BOTH, generation=0):
    check_population_size(name, mirrored, population, learns)
    return member_signs(name, mirrored, population, learns, generation)


@given(num_levels=st.integers(1, 5))
def test_quad_is_balanced_orthogonal_and_complete(num_levels):
    signs = np.array(MIRRORINGS["quad"](num_levels))
    assert not signs.sum(axis=0).any()
    assert np.array_equal(signs.T @ signs, 2**num_levels * np.eye(num_levels))
    assert len(np.unique(signs, axis=0)) == 2**num_levels


@given(
    name=st.sampled_from(sorted(PERTURBATIONS)),
    population=st.integers(1, 60),
    mirrored=st.sampled_from(sorted(MIRRORINGS)),
    learns=st.sampled_from([BOTH, CONTROLLER_ALONE, (False, True), (True,)]),
)
def test_a_population_fits_every_generation_or_none(name, population, mirrored, learns):
    sizes = []
    for generation in (0, 1, 2):
        try:
            sizes.append(np.prod(signs_of(name, population, mirrored, learns, generation).shape[:2]))
        except ConfigError:
            sizes.append(None)
    assert sizes in ([population] * 3, [None] * 3)


@pytest.mark.parametrize(
    ("name", "population", "mirrored", "learns", "message"),
    [
        ("many_to_many", 10, "quad", BOTH, "multiple of 4, a group with 'quad' mirroring, got 10."),
        ("many_to_many", 7, "quad", CONTROLLER_ALONE, "got 7. Set --population-size 6 or 8."),
        ("many_to_many", 0, "none", (True,), "got 0. Set --population-size 1 or 2."),
        ("one_to_many", 7, "quad", BOTH, "multiple of 2, a group with 'quad' mirroring, got 7."),
        ("one_to_many_halves", 10, "quad", BOTH, "multiple of 4, a group with 'quad' mirroring for each level"),
        ("one_to_many_halves", -4, "quad", BOTH, "got -4. Set --population-size 4 or 8."),
        ("one_to_many_halves", 7, "pair", CONTROLLER_ALONE, "multiple of 2, a group with 'pair'"),
    ],
)
def test_a_population_that_groups_do_not_fill_is_refused(name, population, mirrored, learns, message):
    with pytest.raises(ConfigError) as raised:
        signs_of(name, population, mirrored, learns)
    assert message in str(raised.value)
