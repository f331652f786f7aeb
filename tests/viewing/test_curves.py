"""Means of curves, and their intervals."""

import numpy as np
import pytest
from scipy import stats

from shes.viewing.curves import confidence_interval, interpolate, mean_curve, t_quantile


@pytest.mark.parametrize("freedom", [*range(1, 31), 99, 199, 1000, 9999])
def test_a_quantile_of_t_is_scipys(freedom):
    assert t_quantile(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-11)


@pytest.mark.parametrize("runs", [2, 3, 10])
def test_an_interval_is_that_of_students_t(runs):
    values = np.random.default_rng(1).normal(2, 3, size=(runs, 40))
    low, high = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    np.testing.assert_allclose(confidence_interval(values), (low, high))


@pytest.mark.parametrize("runs", [3, 5, 10])
def test_an_interval_holds_the_true_mean_in_95_percent_of_samples(runs):
    low, high = confidence_interval(np.random.default_rng(0).normal(size=(runs, 20_000)))
    assert np.mean((low < 0) & (high > 0)) == pytest.approx(0.95, abs=0.005)  # more than three standard errors


@pytest.mark.parametrize("runs", [1, 3])
def test_runs_that_agree_and_a_single_one_have_no_width(runs):
    low, high = confidence_interval(np.full((runs, 2), 1.5))
    assert low.tolist() == high.tolist() == [1.5, 1.5]


def line(start, end, value=1.0, points=5):
    return np.linspace(start, end, points), np.full(points, value)


def mean_of(*curves):
    return mean_curve(*zip(*curves, strict=True))


def test_a_mean_goes_from_where_all_have_begun_to_where_the_first_one_ends():
    found = mean_of(line(0, 10, 1), line(2, 12, 2), line(1, 40, 6))
    assert (found.grid[0], found.grid[-1], found.end) == (2, 10, 10)
    assert found.mean.tolist() == [3] * len(found.grid)
    assert (found.is_apart, found.singles) == (False, ())
    np.testing.assert_allclose(found.band, confidence_interval(np.tile([[1.0], [2.0], [6.0]], len(found.grid))))


def test_values_between_those_of_a_curve_are_interpolated():
    grid, values = interpolate(
        [np.array([0.0, 2.0]), np.array([1.0, 3.0])], [np.array([0.0, 4.0]), np.array([6.0, 8.0])]
    )
    assert (grid.tolist(), values.tolist()) == ([1, 2], [[2, 4], [6, 7]])


def test_two_runs_are_shown_beside_their_mean_without_a_band():
    curves = line(0, 10, 1), line(0, 12, 2)
    found = mean_of(*curves)
    assert (found.band, found.end) == (None, 12)
    assert set(found.mean) == {1.5}
    for shown, given in zip(found.singles, curves, strict=True):
        np.testing.assert_array_equal(shown, given)


@pytest.mark.parametrize(
    ("spans", "is_apart"),
    [
        ([(0, 10), (11, 21), (0, 10)], True),  # one begins after the others
        ([(0, 10), (6, 16), (0, 10)], True),  # less than half in common
        ([(0, 10), (5, 15), (0, 10)], False),
        ([(0, 1), (0, 10), (0, 10)], True),  # one ended early
        ([(0, 10), (0, 100), (0, 10)], False),  # one is slow
        ([(0, 10), (0, 100), (0, 100)], True),
        ([(3, 3), (3, 3)], False),  # a single evaluation
        ([(3, 3), (4, 4)], True),
    ],
)
def test_runs_that_hardly_overlap_have_no_mean_and_all_are_shown(spans, is_apart):
    curves = [line(*span, points=1 if span[0] == span[1] else 5) for span in spans]
    found = mean_of(*curves)
    assert found.is_apart is is_apart
    if is_apart:
        assert (found.band, len(found.mean), found.end) == (None, 0, max(end for _, end in spans))
        assert [(x[0], x[-1]) for x, _ in found.singles] == spans


def test_a_single_run_is_its_own_mean():
    found = mean_of(line(0, 10, 2))
    assert (found.grid[-1], set(found.mean), found.band, found.singles) == (10, {2}, None, ())
