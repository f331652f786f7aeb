"""Observation statistics: moments that merge, and the normalisation they give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.statistics import ObservationStatistics, normalise


def _merge(statistics, data):
    return statistics.merge(len(data), data.sum(axis=0), (data**2).sum(axis=0))


def test_statistics_of_nothing_have_mean_zero_and_deviation_one():
    empty = ObservationStatistics.empty(3)
    assert empty.count == 0
    assert empty.mean.tolist() == [0, 0, 0]
    assert empty.std.tolist() == [1, 1, 1]


@given(seed=st.integers(0, 2**32), cuts=st.lists(st.integers(0, 200), max_size=6))
def test_merging_equals_one_pass_over_all_data(seed, cuts):
    rng = np.random.default_rng(seed)
    data = rng.normal(rng.uniform(-5, 5, 4), rng.uniform(0.5, 3, 4), (200, 4))
    statistics = ObservationStatistics.empty(4)
    for part in np.split(data, sorted(cuts)):
        statistics = _merge(statistics, part)
    assert statistics.count == 200
    assert statistics.mean == pytest.approx(data.mean(axis=0), rel=1e-10)
    assert statistics.std == pytest.approx(data.std(axis=0), rel=1e-8)


def test_merging_leaves_the_earlier_statistics_as_they_were():
    before = _merge(ObservationStatistics.empty(2), np.ones((5, 2)))
    _merge(before, np.full((5, 2), 9.0))
    assert (before.count, before.total.tolist()) == (5, [5, 5])


def test_the_deviation_is_at_least_a_tenth():
    data = np.array([[2.0, 0.0, 0.0], [2.0, 0.19, 0.21]])  # deviations 0, 0.095, 0.105
    assert _merge(ObservationStatistics.empty(3), data).std == pytest.approx([0.1, 0.1, 0.105])


def test_rounding_below_a_variance_of_zero_is_no_nan():
    value = 1e8 + 0.1
    statistics = _merge(ObservationStatistics.empty(1), np.full((1000, 1), value))
    assert np.isfinite(statistics.std).all()


@pytest.mark.parametrize("count", [2**32 - 1, 2**32, 2**53])
def test_counts_beyond_32_bits_stay_exact(count):
    statistics = ObservationStatistics.empty(1).merge(count, np.array([3.0 * count]), np.array([13.0 * count]))
    statistics = statistics.merge(1, np.array([3.0]), np.array([13.0]))
    assert statistics.count == count + 1
    assert statistics.mean == pytest.approx([3])
    assert statistics.std == pytest.approx([2])


def test_sums_are_float64():
    statistics = ObservationStatistics.empty(2).merge(1, np.ones(2, np.float32), np.ones(2, np.float32))
    assert (statistics.total.dtype, statistics.total_squares.dtype) == (np.float64, np.float64)


def test_normalised_values_of_a_worked_example():
    observation = np.array([[5.0, -1.0], [3.0, 0.5]])
    scaled = normalise(observation, np.array([3.0, 0.0]), 1 / np.array([4.0, 0.5]))
    assert scaled.dtype == np.float32
    assert scaled.tolist() == [[0.5, -2], [0, 1]]


def test_normalised_values_are_clipped_to_five_deviations():
    scaled = normalise(np.array([100.0, -100.0, 5.1, 4.9, -4.9]), np.zeros(5), np.ones(5))
    assert scaled == pytest.approx([5, -5, 5, 4.9, -4.9])


def test_normalising_leaves_the_observation_as_it_was():
    observation = np.array([7.0, 8.0])
    normalise(observation, np.ones(2), np.ones(2))
    assert observation.tolist() == [7, 8]
