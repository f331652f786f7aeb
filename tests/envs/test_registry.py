"""Environments by name, and their ids in Gymnasium."""

import re
from dataclasses import dataclass

import gymnasium
import pytest

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import Body
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.gymnasium_ids import SPECS_OF, register_ids
from shes.envs.named_environments import ENVIRONMENTS, Environment, find_environment, register_environment
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.task import Task, TaskOptions
from shes.errors import ConfigError, UnknownNameError
from shes.settings import Settings
from tests.contracts.variants import VARIANTS
from tests.e2e.own_classes import Corner
from tests.envs.episodes import make_task
from tests.messages import raises


@pytest.fixture(autouse=True)
def restored():
    """Restore the registry after the test."""
    before = dict(ENVIRONMENTS)
    yield
    ENVIRONMENTS.clear()
    ENVIRONMENTS.update(before)


@pytest.mark.parametrize("call", [ENVIRONMENTS.find, find_environment])
def test_an_unknown_environment_is_told_the_nearest_name(call):
    with pytest.raises(UnknownNameError) as caught:
        call("pointgather")
    assert all(name in str(caught.value) for name in ENVIRONMENTS)
    assert "`shes envs` lists them; gymnasium:ID is one of Gymnasium. Register your own first: " in str(caught.value)


SIZES = {
    "AntGather": (50, 50), "AntMaze": (32, 32), "AntPush": (36, 32), "AntFall": (37, 33), "AntFlagrun": (32, 32),
    "PointGather": (25, 25), "PointMaze": (7, 7), "PointPush": (11, 7), "PointFall": (14, 10), "PointFlagrun": (7, 7),
}  # fmt: skip
"""Observed values as the two specifications, shes and hiro, count them."""


@pytest.mark.parametrize("variant", VARIANTS, ids="-".join)
def test_an_id_makes_the_environment_of_its_name(variant):
    name = variant.id.removeprefix("shes/").removesuffix("-v0").removesuffix("Hiro")
    body = Ant if name.startswith("Ant") else FallingPoint if name == "PointFall" else Point
    task, spec = re.findall("[A-Z][a-z]+", name)[1].lower(), "hiro" if "Hiro" in variant.id else "shes"
    for made in (gymnasium.make(variant.id).unwrapped, gymnasium.make_vec(variant.id, num_envs=2)):
        assert (type(made.task.body), made.task.name, made.task.options.spec) == (body, task, spec)
        assert made.observation_space.shape[-1] == made.task.observation_size == SIZES[name][spec == "hiro"]
        fastest = made.observation_space.high[..., made.task.proprioception[-1]]
        assert (fastest == (float("inf") if spec == "hiro" else 10)).all()


def test_every_environment_has_its_id_in_both_specifications(monkeypatch):
    assert {each.id for each in VARIANTS} == {f"shes/{name}{spec}-v0" for name in SIZES for spec in ("", "Hiro")}
    for name, environment in ENVIRONMENTS.items():
        assert name == f"{environment.body.name}-{environment.task.name}"
        assert SPECS_OF[name] == environment.task.specs  # what Gymnasium is told of without importing it
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    monkeypatch.setattr("shes.envs.gymnasium_ids.SPECS_OF", {})
    register_ids("point-corner", Corner.specs)
    assert [each for each in gymnasium.registry if "PointCorner" in each] == ["shes/PointCorner-v0"]


def test_an_environment_may_be_registered_again():
    register_environment("point-corner", Point, Corner)
    assert ENVIRONMENTS["point-corner"] == find_environment("point-corner") == Environment(Point, Corner)
    assert type(make_task("point-corner", 2)) is Corner
    # As a cell of a notebook does that is run again.
    again = type("Corner", (Corner,), {"__module__": Corner.__module__, "__qualname__": "Corner"})
    register_environment("point-corner", Point, again)
    assert find_environment("point-corner").task is again


class Lonely(Corner):
    def __init__(self, body):
        super().__init__(body, 1, TaskOptions())


@dataclass(frozen=True, kw_only=True)
class Sweeping(TaskOptions):
    sweep: bool = True


@dataclass(frozen=True, kw_only=True)
class Heavy(Settings):
    mass: float


Swept, Rock = type("Swept", (Corner,), {"Options": Sweeping}), type("Rock", (Point,), {"Options": Heavy})


@pytest.mark.parametrize(
    ("name", "body", "task", "message"),
    [
        ("Point-Corner", Point, Corner, "environment name must be ... , got 'Point-Corner'"),
        ("ant-gather", Ant, Corner, "'ant-gather' is ... .Ant with ... .Gather already"),
        ("ant-gather", Point, Gather, "'ant-gather' is ... .Ant with ... .Gather already"),
        ("new", Point, Swept, "option 'sweep' of"),
        ("new", Rock, Corner, "option 'mass' of ... Heavy has no default"),
        ("new", Corner, Corner, "a body must be a subclass of ... .Body"),
        ("new", Point, Point, "a task must be a subclass of ... .Task"),
        ("new", Body, Corner, "Body lacks add_to, ... name"),
        ("new", Point, Task, "Task lacks ... observation_spec, ... observe, ... name"),
        ("new", Point, Lonely, "Lonely cannot be constructed with 4 arguments"),
    ],
)
def test_a_wrong_registration_is_refused(name, body, task, message):
    before = dict(ENVIRONMENTS)
    with raises(ConfigError, message):
        register_environment(name, body, task)
    assert before == dict(ENVIRONMENTS)
