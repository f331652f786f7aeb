"""A short run against stored numbers: what no test of a part would notice."""

import json

import pytest

from tests.golden.regenerate import GENERATIONS, GOLDEN_FILE, golden_run

WHAT_TO_DO = (
    "{place} is {value}, the golden file says {golden}. If nothing was meant to change, the last change has a fault. If "
    "numbers were meant to change, run `python -m tests.golden.regenerate` and say 'changes numbers' in CHANGELOG.md."
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


def test_a_short_run_on_point_gather_gives_the_golden_numbers(tmp_path):
    golden = dict(_leaves(json.loads(GOLDEN_FILE.read_text())))
    values = dict(_leaves(golden_run(tmp_path)))
    assert values.keys() == golden.keys(), "regenerate.py writes other entries than the golden file has: run it"
    assert len(values) > 100 * GENERATIONS
    for place, expected in golden.items():
        # Another CPU rounds differently.
        close = pytest.approx(expected, rel=1e-4, abs=1e-6)
        assert values[place] == close, WHAT_TO_DO.format(place=place, value=values[place], golden=expected)
