"""Short runs against stored numbers: what no test of a part would notice."""

import json

import pytest

from tests.golden.regenerate import GENERATIONS, RUNS, golden_file, golden_run

WHAT_TO_DO = (
    "{place} is {value}, the golden file says {golden}. If nothing was meant to change, the last change has a fault. "
    "If they were meant to, run `python -m tests.golden.regenerate {name}`, and say 'changes numbers' in CHANGELOG.md."
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


def _compared(name, change=0.0):
    """Yield the place, the value and the golden value of every number of a run, and whether the two are close."""
    golden = dict(_leaves(json.loads(golden_file(name).read_text(encoding="utf-8"))))
    values = dict(_leaves(golden_run(name, change)))
    assert values.keys() == golden.keys(), "regenerate.py writes other entries than the golden file has: run it"
    for place, expected in golden.items():  # another CPU rounds differently
        yield place, values[place], expected, values[place] == pytest.approx(expected, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("name", RUNS)
def test_a_short_run_gives_the_golden_numbers(name):
    """It sees a thousandth. Ten times the rounding of a float32 must not show: else choose another seed."""
    compared = list(_compared(name))
    assert len(compared) > 25 * GENERATIONS
    for place, value, golden, is_close in compared:
        assert is_close, WHAT_TO_DO.format(place=place, value=value, golden=golden, name=name)
    assert [place for place, *_, is_close in _compared(name, change=1e-6) if not is_close] == []
    assert sum(not is_close for *_, is_close in _compared(name, change=1e-3)) > 20
