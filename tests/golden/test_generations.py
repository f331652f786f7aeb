"""A short run against stored numbers: what no test of a part would notice."""

import json

import pytest

from tests.golden.regenerate import GENERATIONS, GOLDEN_FILE, golden_run

WHAT_TO_DO = (
    "{place} is {value}, the golden file says {golden}. If nothing was meant to change, the last change has a fault. "
    "If numbers were meant to, run `python -m tests.golden.regenerate` and say 'changes numbers' in CHANGELOG.md."
)


def _leaves(value, place=""):
    """Yield (place, number) of everything in nested lists and dicts."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{place}[{number}]")
    else:
        yield place, value


@pytest.fixture(scope="module")
def golden():
    return dict(_leaves(json.loads(GOLDEN_FILE.read_text(encoding="utf-8"))))


def _close(value, expected):
    # Another CPU rounds differently.
    return value == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_a_short_run_on_point_gather_gives_the_golden_numbers(golden, tmp_path):
    values = dict(_leaves(golden_run(tmp_path)))
    assert values.keys() == golden.keys(), "regenerate.py writes other entries than the golden file has: run it"
    assert len(values) > 100 * GENERATIONS
    for place, expected in golden.items():
        message = WHAT_TO_DO.format(place=place, value=values[place], golden=expected)
        assert _close(values[place], expected), message


def test_rounding_stays_below_the_tolerance_of_the_golden_run(golden, tmp_path):
    # Ten times the rounding of a float32. Otherwise choose another SEED: two fitnesses are nearly equal.
    values = dict(_leaves(golden_run(tmp_path, change=1e-6)))
    assert [place for place, expected in golden.items() if not _close(values[place], expected)] == []


def test_a_change_of_a_thousandth_is_seen_by_the_golden_run(golden, tmp_path):
    values = dict(_leaves(golden_run(tmp_path, change=1e-3)))
    assert sum(not _close(values[place], expected) for place, expected in golden.items()) > 20
