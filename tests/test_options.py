"""Options of registered classes: each is a setting of the section in which its class can be chosen."""

import inspect
from dataclasses import dataclass, make_dataclass
from typing import Annotated, ClassVar

import pytest

import shes
from shes.cli import commands, completion
from shes.errors import ConfigError, UnknownNameError
from shes.es.optimizers import OPTIMIZERS, SGD
from shes.options import TAKEN, make, subclass_of, with_options
from shes.registry import Registry
from shes.runs.config import TrainConfig
from shes.runs.sections import known_settings
from shes.settings import Choices, Ge, Gt, Lt, Needs, Settings, Shared, Unasked, setting_fields


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

    shape: Annotated[str, Choices(SHAPES, is_described=True)] = "point"
    """Shape of the thing."""


@dataclass(frozen=True, kw_only=True)
class Other(Settings):
    """Other section."""

    other_shape: Annotated[str, Choices(SHAPES)] = "point"


def test_options_stand_in_the_first_section_that_can_choose_their_class():
    sections = with_options({"section": Section, "other": Other})
    assert list(setting_fields(sections["section"])) == ["shape", "radius", "size"]
    assert sections["other"] is Other
    assert issubclass(sections["section"], Section)
    assert sections["section"]().to_dict() == {"shape": "point", "radius": 1.0, "size": 3}


def test_the_same_sections_have_the_same_classes():
    assert with_options({"section": Section}) == with_options({"section": Section})


def test_an_option_needs_one_of_the_choices_that_have_it():
    options = setting_fields(with_options({"section": Section, "other": Other})["section"])
    assert options["radius"].needs == (Needs("shape", ("ball", "box")), Needs("other_shape", ("ball", "box")))
    assert options["size"].needs == (Needs("shape", ("box",)), Needs("other_shape", ("box",)))


def test_the_help_is_the_docstring_of_the_class():
    options = setting_fields(with_options({"section": Section})["section"])
    assert options["radius"].text == "Radius in metres."
    assert options["size"].text == "Edge length in metres."
    assert options["shape"].text == "Shape of the thing. point: A point; ball: A ball, all around; box: A box."


def test_an_option_is_checked_as_every_setting():
    with pytest.raises(ConfigError, match=r"size must be .*less than 9, got 9\. Set --size"):
        with_options({"section": Section})["section"](size=9)


def test_a_class_is_made_with_its_own_options():
    values = {"radius": 2.0, "size": 4, "other": 1}
    assert make(SHAPES, "ball", values) == Ball(radius=2.0)
    assert type(make(SHAPES, "point", values)) is Point
    with pytest.raises(UnknownNameError, match=r"unknown shape 'bal'. Did you mean 'ball'"):
        make(SHAPES, "bal", values)


def test_a_class_that_is_registered_later_brings_its_options(monkeypatch):
    @dataclass(frozen=True, kw_only=True)
    class Cone(Shape, Settings):
        """A cone."""

        height: Annotated[float, Gt(0)] = 1.0

    monkeypatch.setattr(SHAPES, "_entries", {**SHAPES, "cone": Cone})
    assert "height" in setting_fields(with_options({"section": Section})["section"])


@dataclass(frozen=True, kw_only=True)
class Sphere(Shape, Settings):
    """A ball with another default."""

    radius: Annotated[float, Gt(0)] = 2.0


@dataclass(frozen=True, kw_only=True)
class Marble(Shape, Settings):
    """A ball with another range."""

    radius: Annotated[float, Gt(0), Lt(3)] = 1.0


@pytest.mark.parametrize("other", [Sphere, Marble])
def test_two_classes_with_different_options_of_one_name_are_refused(monkeypatch, other):
    monkeypatch.setattr(SHAPES, "_entries", {**SHAPES, "other": other})
    message = r"'radius' is an option of shape 'ball' and a different one of shape 'other'\. Give both the same type, "
    with pytest.raises(ConfigError, match=message):
        with_options({"section": Section})


def test_classes_of_two_registries_cannot_share_an_option():
    sizes = Registry("size", {"round": Ball}, fix="", check=subclass_of(Shape))
    fields = [("how", Annotated[str, Choices(sizes)], "round")]
    message = r"'radius' is an option of shape 'ball' and a different one of size 'round'\. Choose another name"
    with pytest.raises(ConfigError, match=message):
        with_options({"section": Section, "sizes": make_dataclass("Sizes", fields, bases=(Settings,), frozen=True)})


@dataclass(frozen=True, kw_only=True)
class Egg(Shape, Settings):
    """A shape whose option has the name of a setting."""

    other_shape: Annotated[str, Choices(("oval",))] = "oval"


@dataclass(frozen=True, kw_only=True)
class Twin(Shape, Settings):
    """A shape that shares a setting on purpose."""

    other_shape: Annotated[str, Shared()] = "point"


def test_an_option_has_a_name_of_its_own_unless_it_is_shared(monkeypatch):
    monkeypatch.setattr(SHAPES, "_entries", {**SHAPES, "twin": Twin})
    assert "other_shape" not in setting_fields(with_options({"section": Section, "other": Other})["section"])
    assert make(SHAPES, "twin", {"other_shape": "ball"}) == Twin(other_shape="ball")
    monkeypatch.setattr(SHAPES, "_entries", {**SHAPES, "egg": Egg})
    message = (
        r"'other_shape' is an option of shape 'egg', but already a setting of section 'other'\. Choose another name"
    )
    with pytest.raises(ConfigError, match=message):
        with_options({"section": Section, "other": Other})


@dataclass(frozen=True, kw_only=True)
class Cloud(Shape, Settings):
    out: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Veil(Shape, Settings):
    check: bool = True


@dataclass(frozen=True, kw_only=True)
class Hole(Shape, Settings):
    depth: float


class Crate(Shape):
    @dataclass(frozen=True, kw_only=True)
    class Options(Settings):
        sizes: list[int] | None = None


@pytest.mark.parametrize(
    ("cls", "message"),
    [
        (Cloud, r"option 'out' of .*Cloud has a name that is taken by an argument or a flag .*Choose another name\."),
        (Veil, r"option 'check' of .*Veil has a name that is taken"),
        (Hole, r"option 'depth' of .*Hole has no default\. Give it one\."),
        (Crate, r"Crate\.Options\.sizes has the type list\[int\] \| None, which a setting cannot have\. Use bool"),
    ],
)
def test_an_option_that_no_run_could_have_is_refused_when_its_class_is_registered(cls, message):
    with pytest.raises(ConfigError, match=message):
        SHAPES.register("own", cls)
    assert "own" not in SHAPES


def test_the_taken_names_are_those_of_arguments_and_flags():
    functions = (shes.train, shes.resume, commands.train, commands.resume)
    arguments = {name for each in functions for name in inspect.signature(each).parameters}
    flags = {each[2:].replace("-", "_") for each in (*completion.EVERYWHERE, "--json")}
    other_flags = {each.flag[2:].replace("-", "_") for each in known_settings().values()} - known_settings().keys()
    assert arguments | flags | other_flags == TAKEN


def test_an_optimizer_with_another_momentum_is_refused_by_its_name(monkeypatch):
    @dataclass(frozen=True, kw_only=True)
    class Slow(SGD):
        momentum: Annotated[float, Ge(0), Lt(0.6)] = 0.5

    monkeypatch.setitem(OPTIMIZERS, "slow", Slow)
    with pytest.raises(ConfigError, match=r"'momentum' is an option of optimizer 'sgd' and .* of optimizer 'slow'"):
        TrainConfig.of(env="point-gather", optimizer="slow")


def test_a_run_keeps_the_options_of_its_optimizer_in_the_section_of_the_optimizer():
    config = TrainConfig.of(env="point-gather", optimizer="sgd", momentum=0.5)
    assert config.to_dict()["evolution"]["momentum"] == 0.5
    assert TrainConfig.from_dict(config.to_dict()) == config
    assert known_settings()["momentum"].needs == (Needs("optimizer", ("sgd", "clipup")),)
