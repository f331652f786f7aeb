"""Statistics of samples of seeds, against SciPy, other programs and numbers counted by hand."""

import math

import numpy as np
import pytest
from scipy import stats

from experiments.comparisons import holm, interquartile_mean, mann_whitney, superiority

# The example of R's wilcox.test has the one-sided p 0.1272. Source: Hollander and Wolfe (1973), page 69.
OF_R = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46], [1.15, 0.88, 0.90, 0.74, 1.21]


@pytest.mark.parametrize(
    ("first", "second", "p", "share"),
    [
        ([4, 5, 6], [1, 2, 3], 2 / 20, 0.0),  # the most extreme of the 20 orders
        ([1, 2, 5], [3, 4, 6], 8 / 20, 7 / 9),  # U = 2: 4 of the 20 orders have U <= 2
        (range(10), range(10, 20), 2 / math.comb(20, 10), 1.0),
        ([1, 1], [1, 1], 1.0, 0.5),
        ([0] * 5, [1] * 5, 2 / 252, 1.0),  # ties within the samples: 2 of the 252 divisions part all from all
        ([0, 1], [1, 2], 4 / 6, 7 / 8),  # a tie between them: U = 0.5, as in 2 of the 6 divisions, and none is less
        ([1, 2, 2, 3], [2, 3, 3], 2 * 10 / 35, 9 / 12),  # U = 3: 10 of the 35 divisions have U <= 3
        # The four ones of all are in one sample, as in this share of the divisions.
        ([0] * 10, [0] * 6 + [1] * 4, 2 * math.comb(10, 4) / math.comb(20, 4), 0.7),
        (*OF_R, pytest.approx(2 * 0.1272, abs=1e-4), 0.3),
    ],
)
def test_mann_whitney_and_superiority_counted_by_hand(first, second, p, share):
    first, second = np.array(first, float), np.array(second, float)
    assert superiority(first, second) == pytest.approx(share)
    assert mann_whitney(first, second) == (p if not isinstance(p, float) else pytest.approx(p))


@pytest.mark.parametrize("sizes", [(3, 8), (50, 50)])
def test_mann_whitney_without_ties_agrees_with_scipy(sizes):
    rng = np.random.default_rng(0)
    first, second = (rng.normal(shift, size=size) for shift, size in zip((0, 0.5), sizes, strict=True))
    expected = stats.mannwhitneyu(first, second, method="exact").pvalue
    assert mann_whitney(first, second) == pytest.approx(expected) == mann_whitney(second, first)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([100, 0, 1, 2, 6], 3.0),  # of 1, 2, 6: one value is left out at each end
        ([81, 64, 49, 36, 25, 16, 9, 4, 1, 0], 139 / 6),  # of 4, 9, 16, 25, 36, 49: two at each end
        ([0.3], 0.3),
    ],
)
def test_the_interquartile_mean_agrees_with_a_hand_value(values, expected):
    mean, low, high = interquartile_mean(np.array(values, float))
    assert mean == pytest.approx(expected)
    assert low <= mean <= high


def test_holm_corrects_as_the_textbook_does():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([0.5, None, 0.02]) == [0.5, None, 0.04]
    assert holm([]) == []
