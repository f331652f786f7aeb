"""Options of registered classes: each is a setting of the section in which its class can be chosen."""

import inspect
import json
import pickle
from dataclasses import dataclass, make_dataclass
from typing import Annotated, ClassVar

import pytest

import shes
from shes.agents.rewards import PRIMITIVE_REWARDS, PrimitiveReward
from shes.cli import commands
from shes.errors import ConfigError, UnknownNameError
from shes.options import TAKEN, make, subclass_of, with_options
from shes.registry import Registry
from shes.runs.config import TrainConfig, known_settings
from shes.settings import Choices, Ge, Gt, Lt, Needs, Settings, Unasked
from tests.messages import raises


class Shape:
    """The contract."""


class Point(Shape):
    """A point. It has no options."""


@dataclass(frozen=True, kw_only=True)
class Ball(Shape, Settings):
    """A ball, all around."""

    radius: Annotated[float, Gt(0)] = 1.0
    """Radius in metres."""
    fuzz: Annotated[float, Unasked()] = 0.0


class Box(Shape):
    """A box."""

    @dataclass(frozen=True, kw_only=True)
    class Options(Settings):
        radius: Annotated[float, Gt(0)] = 1.0
        size: Annotated[int, Ge(1), Lt(9)] = 3
        """Edge length in metres."""

    name: ClassVar[str] = "box"


SHAPES = Registry("shape", {"point": Point, "ball": Ball, "box": Box}, fix="Set --shape.", check=subclass_of(Shape))


@dataclass(frozen=True, kw_only=True)
class Section(Settings):
    """Section."""

    shape: Annotated[str, Choices(SHAPES)] = "point"
    """Shape of the thing."""


@dataclass(frozen=True, kw_only=True)
class Other(Settings):
    """Other section."""

    other_shape: Annotated[str, Choices(SHAPES)] = "point"


def test_options_are_in_the_section_that_chooses_their_class():
    found = with_options({"section": Section, "other": Other})
    assert {section: list(own) for section, own in found.items()} == {
        "section": ["shape", "radius", "size"],
        "other": ["other_shape"],
    }
    options = found["section"]
    for name, choices in {"radius": ("ball", "box"), "size": ("box",)}.items():
        assert [*options[name].all_of(Needs)] == [Needs("shape", choices), Needs("other_shape", choices)]
    assert options["radius"].text == "Radius in metres."
    assert options["shape"].text == "Shape of the thing. point: A point; ball: A ball, all around; box: A box."
    with pytest.raises(ConfigError):
        options["size"].checked(9)


def test_a_class_is_made_with_its_own_options():
    values = {"radius": 2.0, "size": 4, "other": 1}
    assert make(SHAPES, "ball", values) == Ball(radius=2.0)
    assert type(make(SHAPES, "point", values)) is Point
    for wrong in (lambda: make(SHAPES, "bal", values), lambda: Section(shape="bal")):
        with pytest.raises(UnknownNameError):
            wrong()


def shape(**options):
    """Return a shape with options: name=(type, default) or name=(type,)."""
    return make_dataclass("New", [(name, *each) for name, each in options.items()], bases=(Shape, Settings),
                          frozen=True, kw_only=True)  # fmt: skip


POSITIVE = Annotated[float, Gt(0)]
TWO_RADII = "'radius' is an option of shape 'ball' and a different one of {}. Choose another name"


@pytest.mark.parametrize(
    ("cls", "message"),
    [
        (shape(radius=(POSITIVE, 2.0)), TWO_RADII.format("shape 'new'")),  # another default
        (shape(radius=(Annotated[float, Gt(0), Lt(3)], 1.0)), TWO_RADII.format("shape 'new'")),  # another range
        (
            shape(other_shape=(Annotated[str, Choices(("oval",))], "oval")),
            "'other_shape' is an option of shape 'new', but already a setting of section 'other'. Choose another",
        ),
    ],
)
def test_an_option_has_one_meaning(monkeypatch, cls, message):
    monkeypatch.setitem(SHAPES, "new", cls)
    with raises(ConfigError, message):
        with_options({"section": Section, "other": Other})


def test_classes_of_two_registries_cannot_share_an_option():
    sizes = Registry("size", {"round": Ball}, fix="", check=subclass_of(Shape))
    with pytest.raises(ConfigError):
        with_options({"section": Section, "sizes": shape(size_of=(Annotated[str, Choices(sizes)], "round"))})


@pytest.mark.parametrize(
    ("cls", "message"),
    [
        (shape(out=(float, 1.0)), "'out' of ... New has a name that is taken by an argument or a flag. Choose another"),
        (shape(check=(bool, True)), "option 'check' of ... New has a name that is taken"),
        (shape(depth=(float,)), "option 'depth' of ... New has no default. Give it one."),
    ],
)
def test_an_option_that_no_run_could_have_is_refused_at_once(cls, message):
    with raises(ConfigError, message):
        SHAPES.register("own", cls)
    assert "own" not in SHAPES


def test_the_taken_names_are_those_of_arguments_and_flags():
    functions = (shes.train, shes.resume, commands.train, commands.resume)
    arguments = {name for each in functions for name in inspect.signature(each).parameters}
    flags = {each[2:].replace("-", "_") for each in ("--help", "--help-all", "--import", "--debug", "--json")}
    other_flags = {each.flag[2:].replace("-", "_") for each in known_settings().values()} - known_settings().keys()
    assert arguments | flags | other_flags == TAKEN


@dataclass(frozen=True, kw_only=True)
class Power(PrimitiveReward, Settings):
    """A power of the distance."""

    exponent: Annotated[float, Ge(0)] = 2.0
    """The power."""

    def __call__(self, distance, start_distance, moved, goal):
        """Return the rewards [N]."""
        return -(distance**self.exponent)


def test_a_run_keeps_the_options_of_its_classes_even_zero(monkeypatch):
    monkeypatch.setitem(PRIMITIVE_REWARDS, "power", Power)
    config = TrainConfig.of(env="point-gather", primitive_reward="power", exponent=0)
    assert config.values["exponent"] == 0
    record = json.loads(json.dumps(config.to_dict()))
    assert record["hierarchy"]["exponent"] == 0
    assert TrainConfig.from_dict(record) == config == pickle.loads(pickle.dumps(config))  # noqa: S301 - our own bytes
    assert config.having(seed=3).values["exponent"] == 0
    assert config != config.having(exponent=1)
    assert make(PRIMITIVE_REWARDS, "power", config.values).exponent == 0
    assert [*known_settings()["exponent"].all_of(Needs)] == [Needs("primitive_reward", ("power",))]
