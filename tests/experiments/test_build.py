"""What is built from settings where users' own classes are in play; the rest is tested through training."""

from pathlib import Path

import pytest

from shes.envs.point import Point
from shes.envs.registry import ENVIRONMENTS, Environment
from shes.errors import ShapeError
from shes.es.noise import NoiseTable
from shes.experiments.build import build_design, build_plan
from shes.experiments.presets import make_config
from tests.e2e.own_classes import Corner


def test_the_plan_carries_the_environment_and_not_its_name(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Corner))
    config = make_config("point-corner", "smoke")
    design = build_design(config)
    plan = build_plan(config, design, NoiseTable.open(config.noise_table_size))
    monkeypatch.delitem(ENVIRONMENTS, "point-corner")  # as in a worker process
    assert type(plan.env.make(1)) is Corner
    assert isinstance(plan.noise_table, Path)


class Shy(Corner):
    def observe(self):
        return super().observe()[:, :-1]


def test_an_environment_that_observes_other_values_than_its_layout_names_is_refused(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Shy))
    message = (
        r"'point-corner' must observe \[N, 6\], .*for 1 episode it observed \(1, 5\)\. Change its layout or its obs"
    )
    with pytest.raises(ShapeError, match=message):
        build_design(make_config("point-corner", "smoke"))
