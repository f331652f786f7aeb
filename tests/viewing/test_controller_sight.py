"""The inputs of a controller in words, for every view."""

import re

import numpy as np
import pytest

from shes.hierarchy.view_choices import CONTROLLER_VIEWS
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config
from shes.viewing.controller_sight import ControllerSight
from shes.viewing.playback import Playback
from tests.e2e import runs


def sight(env, view="observation", **settings):
    """Return a new task and what the controller sees of it."""
    if settings.get("algorithm", "shes") == "shes":
        settings["controller_view"] = view
    problem = build_algorithm(make_config(env, "smoke", settings)).problem
    task = problem.make_task(is_evaluation=True)
    task.reset(np.array([0]), [3])
    return task, ControllerSight(build_algorithm(problem.settings).design.controller_view, task).look()


def test_the_few_inputs_of_a_position_view_are_listed():
    task, words = sight("ant-maze", "position")
    x, y = task.position[0]
    assert words == (
        "controller sees 5 values", f"torso x {x:.2f}", f"torso y {y:.2f}", "time 0.00", "target x 0.00",
        "target y 0.16",
    )  # fmt: skip
    task, words = sight("point-push")
    assert [word.rpartition(" ")[0] for word in words[1:]] == [
        name.replace("_", " ") for name in task.observation_names
    ]


def test_of_many_inputs_position_and_target_are_listed_and_the_others_summed_up():
    task, words = sight("ant-maze")
    x, y = task.position[0]
    seen = dict(zip(task.observation_names, task.observe()[0], strict=True))
    largest = {
        word: max(value for name, value in seen.items() if name.startswith(word) and name not in ("torso_x", "torso_y"))
        for word in ("torso", "hip", "ankle")
    }
    assert words == (
        "controller sees 32 values", f"torso x {x:.2f}", f"torso y {y:.2f}",
        f"11 of torso up to {largest['torso']:.2f}", f"8 of hip up to {largest['hip']:.2f}",
        f"8 of ankle up to {largest['ankle']:.2f}", "time 0.00", "target x 0.00", "target y 0.16",
    )  # fmt: skip


@pytest.mark.parametrize("view", list(CONTROLLER_VIEWS))
def test_every_view_of_gather_is_described(view):
    task, words = sight("ant-gather", view)
    assert words[0] == f"controller sees {50 if view == 'observation' else len_of(task, view)} values"
    assert any(re.match("[12]0 of food up to 0", word) for word in words)
    assert ("time 0.00" in words) == (view != "sectors")


def len_of(task, view):
    return len(CONTROLLER_VIEWS.find(view)().of(task).names(task.observation_names))


def test_hiros_controller_sees_the_whole_observation():
    _, words = sight("point-maze", algorithm="hiro")
    assert words[0] == "controller sees 7 values"


def test_an_agent_without_a_controller_has_no_sight(tiny_run, tmp_path):
    flat = runs.train_tiny(tmp_path / "flat", algorithm="es", generations=1)
    asked, not_asked = (next(Playback(tiny_run, "best", sensors=sensors).play(3)).seen for sensors in (True, False))
    assert (asked[0], not_asked) == ("controller sees 25 values", ())
    assert next(Playback(flat, "best", sensors=True).play(3)).seen == ()
