"""Schedules: exact ends, and a constant factor between them."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.evolution.estimates import Schedule

values = st.floats(1e-6, 1e6)


@given(start=values, end=values, generations=st.integers(1, 10_000), beyond=st.integers(0, 10**9))
def test_start_and_end_are_exact(start, end, generations, beyond):
    schedule = Schedule(start=start, end=end, generations=generations)
    assert (schedule.value(0), schedule.value(generations + beyond)) == (start, end)


@given(start=values, end=values, generations=st.integers(1, 50))
def test_the_factor_is_the_same_in_every_generation(start, end, generations):
    schedule = Schedule(start=start, end=end, generations=generations)
    way = [schedule.value(generation) for generation in range(generations + 1)]
    factor = (end / start) ** (1 / generations)
    assert [later / earlier for earlier, later in pairwise(way)] == pytest.approx([factor] * generations)


def test_values_worked_out_by_hand():
    schedule = Schedule(start=8, end=2, generations=40)
    assert [schedule.value(generation) for generation in (20, 39, 40, 41)] == pytest.approx([4, 2 * 4**0.025, 2, 2])


def test_without_an_end_it_is_constant():
    assert [Schedule(start=0.02).value(generation) for generation in (0, 1, 10**9)] == [0.02] * 3
