"""Which levels a generation perturbs, the signs of its members, and the weights that they give to the noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.es.level import group_weights
from shes.es.perturbation import MIRRORINGS, PERTURBATIONS, sign_matrix
from tests.es.textbook import group_signs

BOTH, CONTROLLER_ALONE, PRIMITIVE_ALONE = (True, True), (True, False), (False, True)

any_name = st.sampled_from(sorted(PERTURBATIONS))
any_mirroring = st.sampled_from(sorted(MIRRORINGS))
any_learns = st.sampled_from([BOTH, CONTROLLER_ALONE, PRIMITIVE_ALONE, (True,)])


def _signs(name, population, mirrored="quad", learns=BOTH, generation=0):
    return PERTURBATIONS.find(name)().signs(generation, population, mirrored, learns)


@given(num_levels=st.integers(1, 5))
def test_quad_is_balanced_orthogonal_and_complete(num_levels):
    signs = sign_matrix("quad", num_levels).astype(int)
    assert not signs.sum(axis=0).any()
    assert np.array_equal(signs.T @ signs, 2**num_levels * np.eye(num_levels))
    assert len(np.unique(signs, axis=0)) == 2**num_levels


@given(name=any_name, mirrored=any_mirroring, learns=any_learns, generation=st.integers(0, 9), groups=st.integers(1, 6))
def test_signs_are_those_of_the_textbook(name, mirrored, learns, generation, groups):
    groups *= sum(learns)  # halves need a share for each level
    expected = group_signs(mirrored, name, learns, groups, generation)
    signs = _signs(name, groups * len(expected[0]), mirrored, learns, generation)
    assert [[tuple(member) for member in group] for group in signs.tolist()] == expected
    assert signs.dtype == np.int8
    signs[:] = 7  # they belong to the caller
    assert _signs(name, groups * len(expected[0]), mirrored, learns, generation).max() == 1


@given(name=any_name, population=st.integers(1, 60), mirrored=any_mirroring, learns=any_learns)
def test_a_population_fits_every_generation_or_none(name, population, mirrored, learns):
    sizes = []
    for generation in (0, 1, 2):
        try:
            sizes.append(np.prod(_signs(name, population, mirrored, learns, generation).shape[:2]))
        except ConfigError:
            sizes.append(None)
    assert sizes in ([population] * 3, [None] * 3)


@pytest.mark.parametrize(
    ("name", "population", "mirrored", "learns", "message"),
    [
        (
            "many_to_many", 10, "quad", BOTH,
            "must be a positive multiple of 4, the size of a group with 'quad' mirroring when 2 levels are perturbed",
        ),
        ("many_to_many", 3, "quad", BOTH, "got 3. Set --population-size 4 or 8."),
        ("many_to_many", 7, "quad", CONTROLLER_ALONE, "1 level is perturbed, got 7. Set --population-size 6 or 8."),
        ("many_to_many", 0, "none", (True,), "got 0. Set --population-size 1 or 2."),
        ("one_to_many", 7, "quad", BOTH, "when 1 level is perturbed, got 7."),
        (
            "one_to_many_halves", 10, "quad", BOTH,
            "must be a positive multiple of 4, a group of 2 with 'quad' mirroring for each level that learns",
        ),
        ("one_to_many_halves", 3, "none", BOTH, "multiple of 2, a group of 1 with 'none' mirroring"),
        ("one_to_many_halves", -4, "quad", BOTH, "got -4. Set --population-size 4 or 8."),
        ("one_to_many_halves", 7, "pair", CONTROLLER_ALONE, "multiple of 2, the size of a group with 'pair'"),
    ],
)  # fmt: skip
def test_a_population_that_groups_do_not_fill_is_refused(name, population, mirrored, learns, message):
    with pytest.raises(ConfigError) as raised:
        _signs(name, population, mirrored, learns)
    assert message in str(raised.value)


def test_unknown_names_are_refused_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"mirroring 'quads'.*'quad'\?.*Known: quad, none, pair\..*--mirrored"):
        _signs("many_to_many", 8, "quads")
    with pytest.raises(UnknownNameError, match=r"'one_to_mny'. Did you mean 'one_to_many'\?.*Set --perturbation\."):
        PERTURBATIONS.find("one_to_mny")


@given(num_groups=st.integers(1, 8), mirrored=any_mirroring, seed=st.integers(0, 2**32))
def test_group_weights_are_signed_sums_over_members(num_groups, mirrored, seed):
    members, rng = sign_matrix(mirrored, 2), np.random.default_rng(seed)
    shaped = rng.uniform(-0.5, 0.5, num_groups * len(members))
    shaped.flags.writeable = False
    # Groups may differ in their signs: some are turned around here, as no caller does yet.
    signs = members * rng.choice([-1, 1], (num_groups, 1, 1)).astype(np.int8)
    for level in (0, 1):
        weights = group_weights(shaped, signs[:, :, level])
        assert weights == pytest.approx((shaped.reshape(num_groups, -1) * signs[:, :, level]).sum(axis=1), abs=1e-6)
        assert weights.dtype == np.float32


@pytest.mark.parametrize("values", [(0.1, 0.2), (1e-17, 1.0), (-0.3, 0.7)])
def test_equal_fitness_on_both_sides_cancels_exactly(values):
    # An optimizer that ignores the gradient's length would take a rounding error for a direction.
    one, other = values
    signs = np.array([[1, 1, 1, -1, -1, -1]] * 3, np.int8)
    shaped = np.array([[one, other, 0.6, 0.6, one, other], [0.6, other, one, one, other, 0.6], [one] * 6])
    assert group_weights(shaped.ravel(), signs).tolist() == [0, 0, 0]
