"""What is built from settings: where users' own classes are in play, and where settings of the estimate arrive.

The rest is tested through training.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shes.envs.bodies.point import Point
from shes.envs.named_environments import ENVIRONMENTS, Environment
from shes.errors import ShapeError
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.e2e.own_classes import Corner
from tests.runs.built import INTERVALS, Built


def test_the_plan_carries_the_environment_and_not_its_name(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Corner))
    config = make_config("point-corner", "smoke")
    plan = build_algorithm(config).plan()
    monkeypatch.delitem(ENVIRONMENTS, "point-corner")  # as in a worker process
    assert type(plan.env.make(1)) is Corner
    assert isinstance(plan.noise_table, Path)


class Shy(Corner):
    def observe(self):
        return super().observe()[:, :-1]


def test_an_environment_that_observes_other_values_than_its_spec_names_is_refused(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Shy))
    message = (
        r"'point-corner' must observe \[N, 6\], .*for 1 episode it observed \(1, 5\)\. Change observation_spec or obs"
    )
    with pytest.raises(ShapeError, match=message):
        build_algorithm(make_config("point-corner", "smoke"))


SCHEDULE = {"sigma_end": 0.05, "schedule_generations": 2}


@pytest.fixture(scope="module")
def beside():
    """What is built for a primitive that is judged by intervals beside a controller."""
    return Built.of("ant-gather", **INTERVALS)


@pytest.mark.parametrize("symmetry", ["rotation", "dihedral"])
def test_agents_get_the_elements_of_the_symmetry_that_is_asked_for(symmetry):
    built = Built.of("ant-flagrun", primitive_view="egocentric", symmetry=symmetry)
    assert built.design.symmetry.num_elements == {"rotation": 4, "dihedral": 8}[symmetry]


def test_what_acts_in_branches_is_the_primitive_of_the_runs_agent(beside):
    branch = beside.plan.branch_design
    assert branch == replace(beside.design, controller=None, num_recorded_goals=2)
    assert branch.dims == beside.design.dims[1:]


def test_a_primitive_alone_acts_in_branches_as_everywhere_and_has_the_runs_own_rates():
    built = Built.of("ant-flagrun", **INTERVALS, **SCHEDULE, fall_price=2.0)
    assert built.plan.branch_design is None
    estimate = built.intervals
    assert (estimate.population_size, built.rules[0].fall_price) == (8, 2)
    assert [estimate.sigma.value(g) for g in range(4)] == pytest.approx([0.2, 0.1, 0.05, 0.05])
    assert [estimate.sigma.value(g) for g in range(4)] == [built.settings.sigma.value(g) for g in range(4)]
    assert estimate.learning_rate.value(0) == 0.04


def test_without_rates_of_its_own_a_primitive_beside_a_controller_has_the_runs():
    built = Built.of("ant-gather", **INTERVALS, **SCHEDULE)
    assert [built.intervals.sigma.value(g) for g in range(3)] == pytest.approx([0.2, 0.1, 0.05])
    own = Built.of("ant-gather", **INTERVALS, **SCHEDULE, primitive_sigma=0.3)
    assert [own.intervals.sigma.value(g) for g in range(3)] == [0.3] * 3
    assert [own.settings.sigma.value(g) for g in range(3)] == pytest.approx([0.2, 0.1, 0.05])


def test_by_whole_episodes_there_is_nothing_of_the_estimate():
    built = Built.of("ant-gather", fall_price=2.0)
    assert built.intervals is None
    assert built.plan.branch_design is None
    assert built.settings.by_episodes == (True, True)
    assert [rule.fall_price for rule in built.rules] == [0, 2]  # falls of whole episodes have their price, too


def test_by_intervals_whole_episodes_judge_the_controller_alone(beside):
    assert (beside.settings.learns, beside.settings.by_episodes) == ((True, True), (True, False))
    assert np.array_equal(np.abs(beside.settings.signs(0)).max(axis=(0, 1)), [1, 0])
