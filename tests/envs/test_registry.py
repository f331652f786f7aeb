"""Environments by name, and the options of a task."""

from dataclasses import dataclass

import numpy as np
import pytest

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import Body
from shes.envs.bodies.point import Point
from shes.envs.gymnasium_ids import SPECS_OF
from shes.envs.registry import ENVIRONMENTS, Environment, find_environment, make_task, register_environment
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.task import Task
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError, UnknownNameError
from shes.settings import Settings
from shes.sim.cpu import CpuSimulator
from tests.e2e.own_classes import Corner


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_name_is_its_body_and_its_task(name):
    body, task = ENVIRONMENTS[name]
    assert issubclass(body, Body)
    assert issubclass(task, Task)
    assert name == f"{body.name}-{task.name}"


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_name_makes_its_task(name):
    find_environment(name)
    task = make_task(name, 2)
    body, kind = ENVIRONMENTS[name]
    assert type(task) is kind
    assert type(task.body) is body
    assert task.num_episodes == 2
    assert task.options == kind.Options()


def test_gather_is_there_for_ant_and_point():
    assert ENVIRONMENTS["ant-gather"] == (Ant, Gather)
    assert ENVIRONMENTS["point-gather"] == (Point, Gather)


@pytest.mark.parametrize("call", [ENVIRONMENTS.find, find_environment, lambda name: make_task(name, 1)])
@pytest.mark.parametrize(("wrong", "right"), [("ant-gathr", "ant-gather"), ("pointgather", "point-gather")])
def test_an_unknown_environment_is_refused_with_the_nearest_name(call, wrong, right):
    with pytest.raises(UnknownNameError, match=rf"unknown environment '{wrong}'. Did you mean '{right}'\?") as caught:
        call(wrong)
    for name in ENVIRONMENTS:
        assert name in str(caught.value)
    assert "`shes envs` lists them; gymnasium:ID is one of Gymnasium. Register your own first: " in str(caught.value)


def test_a_name_unlike_any_other_gets_no_suggestion():
    with pytest.raises(UnknownNameError, match=r"unknown environment 'zzz'. Known: ant-fall, "):
        find_environment("zzz")


def test_an_unknown_integrator_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"unknown integrator 'Euler'. Did you mean 'euler'\?.*--integrator"):
        TaskOptions(integrator="Euler")


@pytest.mark.parametrize("noise", [-0.1, -1e-9, 1.0, 5.0, np.nan, np.inf])
def test_reset_noise_outside_0_to_1_is_refused(noise):
    with pytest.raises(
        ConfigError, match=rf"reset_noise must be at least 0 and less than 1, got {noise}\. Set --reset-noise"
    ):
        TaskOptions(reset_noise=noise)


def test_options_default_to_the_specification():
    options = TaskOptions()
    assert options.integrator == "euler"
    assert options.reset_noise == 0.1
    assert not options.evaluation


def test_a_task_uses_the_simulator_it_is_given():
    made = []

    def simulator(model, num_sims):
        made.append(CpuSimulator(model, num_sims))
        return made[-1]

    task = make_task("point-gather", 3, simulator=simulator)
    assert [task.sim] == made
    assert task.sim.num_sims == 3


# Environments of users.


@pytest.fixture
def registry():
    """The registry, which is restored after the test."""
    before = dict(ENVIRONMENTS)
    yield ENVIRONMENTS
    ENVIRONMENTS.clear()
    ENVIRONMENTS.update(before)


def test_a_registered_environment_is_known_by_its_name(registry):
    register_environment("point-corner", Point, Corner)
    assert registry["point-corner"] == find_environment("point-corner") == Environment(Point, Corner)
    find_environment("point-corner")
    task = make_task("point-corner", 2)
    assert type(task) is Corner
    assert type(task.body) is Point


def test_the_same_environment_may_be_registered_again_and_made_anew(registry):
    register_environment("point-corner", Point, Corner)
    register_environment("point-corner", Point, Corner)
    # As a cell of a notebook does that is run again.
    again = type("Corner", (Corner,), {"__module__": Corner.__module__, "__qualname__": "Corner"})
    register_environment("point-corner", Point, again)
    assert find_environment("point-corner").task is again


@pytest.mark.parametrize("classes", [(Point, Corner), (Ant, Corner), (Point, Gather)])
def test_a_taken_name_is_refused(registry, classes):
    message = (
        r"environment 'ant-gather' is shes\.envs\.bodies\.ant\.Ant with shes\.envs\.tasks\.gather\.Gather already\. "
        "Choose another name"
    )
    with pytest.raises(ConfigError, match=message):
        register_environment("ant-gather", *classes)
    assert registry["ant-gather"] == (Ant, Gather)


@pytest.mark.parametrize(
    "name", ["", "Point-Corner", "point corner", "-point", "point-", "point--corner", "2d", None, 3]
)
def test_a_malformed_name_is_refused(registry, name):
    message = rf"environment name must be lower-case words .*joined by - or _, got {name!r}\. For example"
    with pytest.raises(ConfigError, match=message):
        register_environment(name, Point, Corner)


@pytest.mark.parametrize("name", ["corner", "point-corner", "point_corner_2", "a1-b2_c3"])
def test_names_are_lower_case_words(registry, name):
    register_environment(name, Point, Corner)
    find_environment(name)


class Sized(Point):
    def __init__(self, size):
        self.size = size


class Lonely(Corner):
    def __init__(self, body):
        super().__init__(body, 1, TaskOptions())


@dataclass(frozen=True, kw_only=True)
class Sweeping(TaskOptions):
    sweep: bool = True


@dataclass(frozen=True, kw_only=True)
class Heavy(Settings):
    mass: float


@pytest.mark.parametrize(
    ("body", "task", "message"),
    [
        (
            Point,
            type("Swept", (Corner,), {"Options": Sweeping}),
            r"option 'sweep' of .*Sweeping has a name that is taken",
        ),
        (type("Rock", (Point,), {"Options": Heavy}), Corner, r"option 'mass' of .*Heavy has no default"),
        (
            Corner,
            Corner,
            r"a body must be a subclass of shes\.envs\.bodies\.body\.Body, got <class '.*Corner'>\. Write class Y",
        ),
        (
            Point,
            Point,
            r"a task must be a subclass of shes\.envs\.tasks\.task\.Task, got <class '.*Point'>\. Write class Your",
        ),
        (
            Point(),
            Corner,
            r"a body must be .*got <shes\.envs\.bodies\.point\.Point object.*give the class, not an object of it",
        ),
        (Point, "Corner", r"a task must be .*got 'Corner'"),
        (
            Body,
            Corner,
            r"body shes\.envs\.bodies\.body\.Body lacks add_to, .*name, .*says what each of them is: add them",
        ),
        (Point, Task, r"task shes\.envs\.tasks\.task\.Task lacks .*build_world, .*observe, .*name, description\. "),
        (Sized, Corner, r"body .*Sized cannot be constructed with no arguments: .*'size'\. Change its __init__"),
        (Point, Lonely, r"task .*Lonely cannot be constructed with 4 arguments: too many .*Change its __init__"),
    ],
)
def test_what_is_no_complete_class_is_refused(registry, body, task, message):
    with pytest.raises(ConfigError, match=message):
        register_environment("point-corner", body, task)
    assert "point-corner" not in registry


def test_a_class_without_a_class_attribute_is_refused(registry):
    nameless = type("Nameless", (Task,), dict.fromkeys(Task.__abstractmethods__))
    with pytest.raises(
        ConfigError, match=r"Nameless lacks name, description\. shes\.envs\.tasks\.task\.Task says what"
    ):
        register_environment("nameless", Point, nameless)


def test_gymnasium_is_told_of_every_environment_without_importing_it():
    assert SPECS_OF.items() >= {name: each.task.specs for name, each in ENVIRONMENTS.items()}.items()
