"""Fitness shaping: what the update needs of every one, and the numbers of each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, PolicyError, UnknownNameError
from shes.es.ranking import TIES, centred_ranks
from shes.es.shaping import FITNESS_SHAPINGS, CentredRanks, PairRanks
from shes.options import make

# Few values, so many ties, and all exact in binary after any shift and scale below.
fitnesses = st.lists(st.integers(-6, 6), min_size=1, max_size=25).map(lambda values: [*values, *reversed(values)])
wide = st.lists(st.floats(-1e300, 1e300), min_size=20, max_size=20)
every_ties = pytest.mark.parametrize("ties", TIES)
every_shaping = pytest.mark.parametrize(
    "shaping", [*(CentredRanks(rank_ties=ties) for ties in TIES), PairRanks()], ids=str
)


def _array(values):
    return np.array(values, dtype=float)


@every_shaping
@given(fitness=st.one_of(fitnesses, wide), shift=st.integers(-1000, 1000), scale=st.sampled_from([0.125, 1, 3, 4096]))
def test_shift_and_scale_have_no_effect(shaping, fitness, shift, scale):
    values = _array(fitness)
    shaped = shaping(values)
    assert (shaped.shape, shaped.dtype) == (values.shape, np.float64)
    assert abs(shaped.sum()) < 1e-9
    if np.abs(values).max() < 10:
        assert shaping(values * scale + shift) == pytest.approx(shaped, abs=1e-9)


@every_ties
@given(fitness=st.one_of(fitnesses, wide))
def test_a_better_member_never_counts_less(ties, fitness):
    shaped = CentredRanks(rank_ties=ties)(_array(fitness))
    for mine, value in zip(fitness, shaped, strict=True):
        assert all(value >= other for theirs, other in zip(fitness, shaped, strict=True) if mine > theirs)


@pytest.mark.parametrize("name", FITNESS_SHAPINGS)
@pytest.mark.parametrize("value", [0.0, 0.1, -7.3, 1e300, 5e-324])
def test_equal_fitness_counts_nothing(name, value):
    assert np.all(FITNESS_SHAPINGS.find(name)()(np.full(10, value)) == 0)


@every_shaping
def test_the_fitness_is_not_changed(shaping):
    fitness = _array([3, 1, 2, 2])
    shaping(fitness)[:] = 99
    assert fitness.tolist() == [3, 1, 2, 2]


@every_shaping
@pytest.mark.parametrize(("value", "word"), [(np.nan, "nan"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_a_fitness_that_is_not_finite_is_refused(shaping, value, word):
    with pytest.raises(PolicyError, match=rf"fitness of member 2 is {word}, but every fitness must be finite"):
        shaping(_array([0, 1, value, value]))


@given(pairs=st.lists(st.tuples(st.integers(-6, 6), st.integers(-6, 6)), min_size=1, max_size=25))
def test_pair_ranks_are_the_signed_ranks_of_scipy(pairs):
    from scipy.stats import rankdata

    difference = np.array([one - other for one, other in pairs])
    expected = np.sign(difference) * rankdata(np.abs(difference)) / len(pairs)
    shaped = PairRanks()(_array(pairs).ravel())
    assert shaped[0::2] - shaped[1::2] == pytest.approx(expected, abs=1e-12)
    assert shaped[0::2] == pytest.approx(-shaped[1::2])


def test_what_both_of_a_pair_share_has_no_effect():
    base, shifts = _array([1, 2, 5, 3, 0, 0]), np.repeat([10.0, -40.0, 3.0], 2)
    assert PairRanks()(base + shifts).tolist() == PairRanks()(base).tolist()
    assert PairRanks()(base).tolist() == pytest.approx([-2 / 6, 2 / 6, 0.5, -0.5, 0, 0])


def test_pair_ranks_refuse_an_odd_population():
    with pytest.raises(ConfigError, match=r"odd number of members, 3\. Set --mirrored pair"):
        PairRanks()(_array([1, 2, 3]))


@every_ties
@given(fitness=fitnesses)
def test_centred_ranks_are_those_of_ranking(ties, fitness):
    shaping = make(FITNESS_SHAPINGS, "centred_rank", {"rank_ties": ties, "other": 1})
    assert shaping(_array(fitness)).tobytes() == centred_ranks(_array(fitness), ties).tobytes()


@pytest.mark.parametrize(
    ("make_it", "message"),
    [
        (lambda: FITNESS_SHAPINGS.find("pair_rnk"), r"fitness shaping 'pair_rnk'.*'pair_rank'\?.*--fitness-shaping"),
        (lambda: CentredRanks(rank_ties="averge"), r"'averge'.*Did you mean 'average'\?.*--rank-ties"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(make_it, message):
    with pytest.raises(UnknownNameError, match=message):
        make_it()
