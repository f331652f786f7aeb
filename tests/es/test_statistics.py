"""Observation statistics: moments that merge, and the normalisation they give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.agents.mlp import normalise
from shes.es.statistics import ObservationStatistics


def _merge(statistics, data):
    return statistics.merge(len(data), data.sum(axis=0), (data**2).sum(axis=0))


@given(seed=st.integers(0, 2**32), cuts=st.lists(st.integers(0, 200), max_size=6))
def test_merging_equals_one_pass_over_all_data(seed, cuts):
    rng = np.random.default_rng(seed)
    data = rng.normal(rng.uniform(-5, 5, 4), rng.uniform(0.5, 3, 4), (200, 4))
    statistics = ObservationStatistics.empty(4)
    for part in np.split(data, sorted(cuts)):
        before = statistics
        statistics = _merge(before, part)
        assert before.count == statistics.count - len(part)  # the earlier ones stay as they were
    assert statistics.count == 200
    assert statistics.mean == pytest.approx(data.mean(axis=0), rel=1e-10)
    assert statistics.std == pytest.approx(data.std(axis=0), rel=1e-8)


def test_the_deviation_is_at_least_a_tenth():
    data = np.array([[2.0, 0.0, 0.0], [2.0, 0.19, 0.21]])  # deviations 0, 0.095, 0.105
    assert _merge(ObservationStatistics.empty(3), data).std == pytest.approx([0.1, 0.1, 0.105])
    assert _merge(ObservationStatistics.empty(3), data[:1]).std.tolist() == [0.1] * 3
    large = np.full((1000, 1), 1e8 + 0.1)  # the variance rounds to a negative number
    assert np.isfinite(_merge(ObservationStatistics.empty(1), large).std).all()


@pytest.mark.parametrize("count", [2**32 - 1, 2**32, 2**53])
def test_counts_beyond_32_bits_stay_exact(count):
    statistics = ObservationStatistics.empty(1).merge(count, np.array([3.0 * count]), np.array([13.0 * count]))
    statistics = statistics.merge(1, np.array([3], np.float32), np.array([13], np.float32))
    assert statistics.count == count + 1
    assert (statistics.mean, statistics.std) == (pytest.approx([3]), pytest.approx([2]))
    assert (statistics.total.dtype, statistics.total_squares.dtype) == (np.float64, np.float64)


def test_normalised_values_are_clipped_to_five_deviations():
    observation = np.array([[5.0, -1.0], [3.0, 0.5], [1e9, 2.45], [-1e9, -2.55]])
    observation.flags.writeable = False
    scaled = normalise(observation, np.array([3.0, 0.0]), 1 / np.array([4.0, 0.5]))
    assert scaled == pytest.approx(np.array([[0.5, -2], [0, 1], [5, 4.9], [-5, -5]]))
    assert scaled.dtype == np.float32
