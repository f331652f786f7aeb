"""Fitness shaping: what the update needs of every one, and the numbers of each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import PolicyError
from shes.es.level import UpdateRule
from shes.es.shaping import FITNESS_SHAPINGS, PairRanks
from tests.es import textbook

# Few values, so many ties, and all exact in binary after any shift and scale below.
fitnesses = st.lists(st.integers(-6, 6), min_size=1, max_size=25).map(lambda values: [*values, *reversed(values)])
wide = st.lists(st.floats(-1e300, 1e300), min_size=20, max_size=20)
every_shaping = pytest.mark.parametrize(
    "shaping", [cls() for cls in FITNESS_SHAPINGS.values()], ids=list(FITNESS_SHAPINGS)
)


def _array(values):
    return np.array(values, dtype=float)


@every_shaping
@given(fitness=st.one_of(fitnesses, wide), shift=st.integers(-1000, 1000), scale=st.sampled_from([0.125, 1, 3, 4096]))
def test_shift_and_scale_have_no_effect(shaping, fitness, shift, scale):
    values = _array(fitness)
    values.flags.writeable = False
    shaped = shaping(values)
    assert (shaped.shape, shaped.dtype) == (values.shape, np.float64)
    assert abs(shaped.sum()) < 1e-9
    if np.abs(values).max() < 10:
        assert shaping(values * scale + shift) == pytest.approx(shaped, abs=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_fitness_that_is_not_finite_is_refused(value):
    """Unless the member does not perturb the level."""
    fitness, rule = _array([0, 1, value, value, 3, 4]), UpdateRule()
    with pytest.raises(PolicyError):
        rule.shape(fitness, np.array([[1, -1]] * 3, np.int8))
    shaped = rule.shape(fitness, np.array([[1, -1], [0, 0], [1, -1]], np.int8))
    assert shaped.tolist() == textbook.centred_ranks([0, 1, 3, 4], "average")


@pytest.mark.parametrize(("name", "ties"), [("centred_rank", "average"), ("centred_rank_index", "index")])
@given(fitness=st.one_of(fitnesses, wide, st.lists(st.integers(-1000, 1000), min_size=2)))
def test_centred_ranks_count_beaten_members(name, ties, fitness):
    shaping = FITNESS_SHAPINGS.find(name)()
    assert shaping(_array(fitness)) == pytest.approx(textbook.centred_ranks(fitness, ties))
    assert shaping(_array(fitness[:1])).tolist() == [0]


@given(pairs=st.lists(st.tuples(st.integers(-6, 6), st.integers(-6, 6)), min_size=1, max_size=25))
def test_pair_ranks_are_signed_ranks_of_wilcoxon(pairs):
    difference = np.array([one - other for one, other in pairs])
    size = np.abs(difference)
    ranks = np.array([(size < each).sum() + ((size == each).sum() + 1) / 2 for each in size])
    expected = np.sign(difference) * ranks / len(pairs)
    shaped = PairRanks()(_array(pairs).ravel())
    assert shaped[0::2] - shaped[1::2] == pytest.approx(expected, abs=1e-12)
    assert shaped[0::2] == pytest.approx(-shaped[1::2])
