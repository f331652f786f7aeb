"""Means of curves, and their intervals."""

import numpy as np
import pytest
from scipy import stats

from shes.viewing.curves import column_curve, confidence_interval, mean_curve


@pytest.mark.parametrize("runs", [2, 3, 4, 10, 100])
def test_an_interval_is_that_of_students_t(runs):
    values = np.random.default_rng(1).normal(2, 3, size=(runs, 40))
    low, high = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    np.testing.assert_allclose(confidence_interval(values), (low, high), rtol=1e-7)
    np.testing.assert_array_equal(confidence_interval(values[:1]), (values[0], values[0]))


def line(start, end, value=1.0, points=5):
    return np.linspace(start, end, points), np.full(points, value)


def test_a_mean_is_where_all_runs_have_values():
    found = mean_curve(line(0, 10, 1), line(2, 12, 2), line(1, 40, 6))
    assert (found.grid[0], found.grid[-1]) == (2, 10)
    assert found.mean.tolist() == [3] * len(found.grid)
    assert (found.is_apart, found.singles) == (False, ())
    np.testing.assert_allclose(found.band, confidence_interval(np.tile([[1.0], [2.0], [6.0]], len(found.grid))))


def test_two_runs_are_shown_with_their_interpolated_mean():
    curves = (np.array([0.0, 2.0]), np.array([0.0, 4.0])), (np.array([1.0, 3.0]), np.array([6.0, 8.0]))
    found = mean_curve(*curves)
    assert (found.grid.tolist(), found.mean.tolist(), found.band) == ([1, 2], [4, 5.5], None)
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
        ([(3, 3), (3, 3)], False),  # a single evaluation
        ([(3, 3), (4, 4)], True),
    ],
)
def test_runs_that_hardly_overlap_have_no_mean(spans, is_apart):
    found = mean_curve(*(line(*span, points=1 if span[0] == span[1] else 5) for span in spans))
    assert found.is_apart is is_apart
    if is_apart:
        assert (found.band, len(found.mean)) == (None, 0)
        assert [(x[0], x[-1]) for x, _ in found.singles] == spans


def test_a_single_run_has_two_standard_errors_over_episodes():
    table = {"wall_time_s": np.array([60.0, 120.0]), "score_mean": np.array([3.0, 5.0])}
    assert column_curve([table], "score_mean", "wall_time_s").band is None
    spread = {"score_std": np.array([4.0, 0.0]), "episodes": np.full(2, 16.0)}
    curve = column_curve([{**table, **spread}], "score_mean", "wall_time_s")
    assert (curve.grid.tolist(), curve.mean.tolist(), curve.singles) == ([1, 2], [3, 5], ())
    np.testing.assert_allclose(curve.band, ([1, 5], [5, 5]))
