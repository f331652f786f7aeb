"""Schedules: exact ends, the way between them, and the names in their errors."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.schedules import SCHEDULES, Schedule

every_kind = pytest.mark.parametrize("kind", SCHEDULES)
moving = pytest.mark.parametrize("kind", [kind for kind in SCHEDULES if kind != "constant"])
values = st.floats(1e-6, 1e6)


def _make(kind, start=0.1, end=0.001, generations=100):
    return Schedule(kind=kind, start=start, end=end, generations=generations)


@every_kind
@given(start=values, end=values, generations=st.integers(1, 10_000))
def test_the_start_is_exact(kind, start, end, generations):
    assert _make(kind, start, end, generations).value(0) == start


@moving
@given(start=values, end=values, generations=st.integers(1, 10_000), beyond=st.integers(0, 10**9))
def test_the_end_is_exact_and_stays(kind, start, end, generations, beyond):
    assert _make(kind, start, end, generations).value(generations + beyond) == end


@every_kind
@given(start=values, end=values, generations=st.integers(1, 50))
def test_the_way_is_monotone_and_between_the_ends(kind, start, end, generations):
    schedule = _make(kind, start, end, generations)
    way = [schedule.value(g) for g in range(generations + 2)]
    sign = 1 if end >= start else -1
    slack = 1e-12 * max(start, end)
    assert all(sign * (later - earlier) >= -slack for earlier, later in pairwise(way))
    assert all(min(start, end) - slack <= value <= max(start, end) + slack for value in way)


@every_kind
@given(start=values, generations=st.integers(1, 50))
def test_equal_ends_are_constant(kind, start, generations):
    schedule = _make(kind, start, start, generations)
    assert all(schedule.value(g) == pytest.approx(start, rel=1e-14) for g in range(generations + 2))


@pytest.mark.parametrize(
    ("kind", "quarter", "half"),
    [
        ("constant", 8, 8),
        ("linear", 6.5, 5),  # 8 - 6 p
        ("exponential", 8 / math.sqrt(2), 4),  # 8 * 4**-p
        ("cosine", 5 + 3 / math.sqrt(2), 5),  # 2 + 6 (1 + cos(pi p)) / 2
    ],
)
def test_values_worked_out_by_hand(kind, quarter, half):
    schedule = _make(kind, 8, 2, 40)
    assert schedule.value(10) == pytest.approx(quarter)
    assert schedule.value(20) == pytest.approx(half)


@given(start=values, end=values, generations=st.integers(3, 200))
def test_linear_differences_and_exponential_factors_are_the_same_every_generation(start, end, generations):
    linear, geometric = (_make(kind, start, end, generations) for kind in ("linear", "exponential"))
    for g in range(generations):
        step = linear.value(g + 1) - linear.value(g)
        assert step == pytest.approx((end - start) / generations, rel=1e-6, abs=1e-9 * max(start, end))
        assert geometric.value(g + 1) / geometric.value(g) == pytest.approx((end / start) ** (1 / generations))


def test_a_constant_ignores_its_end_and_generations():
    assert [_make("constant", 0.02, -1, 0).value(g) for g in (0, 1, 10**9)] == [0.02] * 3


@pytest.mark.parametrize("kind", ["linear", "cosine"])
def test_a_value_may_fall_to_zero(kind):
    assert _make(kind, 1, 0, 10).value(10) == 0


def test_a_value_may_grow():
    assert [_make("linear", 1, 5, 4).value(g) for g in range(6)] == [1, 2, 3, 4, 5, 5]
