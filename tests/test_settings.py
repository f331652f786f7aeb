"""Settings: the annotation of a field says which values are allowed, and the error says so."""

import inspect
from dataclasses import dataclass, make_dataclass
from typing import Annotated, Literal

import numpy as np
import pytest

from shes.errors import ConfigError, UnknownNameError
from shes.runs.config import known_settings
from shes.settings import Choices, Example, Ge, Gt, Le, Lt, Settings, Shown, checked, setting_fields
from tests.messages import raises

NAMES = {"near": 1}


@dataclass(frozen=True, kw_only=True)
class EveryKind(Settings):
    """A setting of every kind."""

    whole: Annotated[int, Ge(2)] = 2
    """A text
    of two lines."""
    seed: Annotated[int, Ge(0), Lt(9000)] = 0
    positive: Annotated[float, Gt(0)] = 1.0
    zero: Annotated[float, Ge(0)] = 0.0
    share: Annotated[float, Ge(0), Le(1)] = 1.0
    open_share: Annotated[float, Gt(0), Lt(1)] = 0.5
    momentum: Annotated[float, Ge(0), Lt(1)] = 0.5
    word: Literal["one", "two"] = "one"
    name: Annotated[str, Choices(NAMES)] = "near"
    path: Annotated[str, Example("runs/a")] | None = None
    switch: bool = True
    maybe: bool | None = None
    layers: Annotated[tuple[int, ...], Ge(1), Example("64 64"), Shown(flag="--net")] = (8,)
    place: Annotated[tuple[float, ...], Ge(-9), Le(9), Example("0 8")] | None = None
    span: tuple[float, float] = (0.0, 1.0)


NOT_NUMBERS = ["1", True, None, float("nan"), float("inf"), [1], 1j]
WRONG = {
    "span": ("2 numbers", [(1.0,), (0.0, 1.0, 2.0), (), ("a", "b"), 1.0]),
    "whole": ("a whole number of at least 2", [1, 2.5, -(10**400), *NOT_NUMBERS]),
    "seed": ("a whole number of at least 0 and less than 9000", [-1, 9000, 1.5]),
    "positive": ("a number greater than 0", [0, -0.1, *NOT_NUMBERS]),
    "zero": ("a number of at least 0", [-0.1, *NOT_NUMBERS]),
    "share": ("a number of at least 0 and at most 1", [-0.1, 1.1, *NOT_NUMBERS]),
    "open_share": ("a number greater than 0 and less than 1", [0, 1, *NOT_NUMBERS]),
    "momentum": ("a number of at least 0 and less than 1", [-0.1, 1, *NOT_NUMBERS]),
    "word": ("one of one, two", [1, None, ["one"], b"one"]),
    "name": ("one of near", [3, None]),
    "path": ("a name, e.g. --path runs/a", ["", 3, True]),
    "switch": ("true or false", [1, 0, "no", None, []]),
    "maybe": ("true or false", ["no", 0.0]),
    "layers": (
        "whole numbers of at least 1, e.g. --net 64 64",
        [(0,), (8, -1), (8.5,), ("8",), (True,), 0, 8.5, True, "8 8", None],
    ),
    "place": (
        "numbers of at least -9 and at most 9, e.g. --place 0 8",
        [10, "ab", ("0", "1"), [[1], [2]], {0: 1}, (True, 1), (0, None), (0, np.nan), (9.1, 0), (), np.zeros((2, 1))],
    ),
}


def test_every_kind_of_setting_has_a_row_here():
    assert WRONG.keys() == setting_fields(EveryKind).keys()
    assert setting_fields(EveryKind)["whole"].text == "A text of two lines."


@pytest.mark.parametrize("name", WRONG)
def test_a_value_out_of_range_is_refused_with_its_flag(name):
    allowed, values = WRONG[name]
    flag = setting_fields(EveryKind)[name].flag
    for value in values:
        with raises(ConfigError, f"{name} must be {allowed}, got ... . Set {flag}."):
            EveryKind(**{name: value})


@pytest.mark.parametrize("kind", [Literal[1, 2], list[int], tuple[float, str], tuple[str, ...], tuple[()], int | str])
def test_a_field_of_an_unsupported_type_is_refused(kind):
    cls = make_dataclass("Odd", [("sort", kind, 1)], bases=(Settings,), frozen=True, kw_only=True)
    with raises(ConfigError, "Odd.sort has the type ... , which a setting cannot have. Use bool, int, "):
        setting_fields(cls)


def test_values_of_numpy_become_those_of_python():
    given = {
        "whole": 7.0, "positive": np.float32(0.5), "switch": np.False_, "layers": [np.int64(4)],
        "place": np.array([8.0, 3.5]), "word": np.str_("two"),
    }  # fmt: skip
    made = EveryKind(**given)
    plain = {"whole": 7, "positive": 0.5, "switch": False, "layers": (4,), "place": (8.0, 3.5), "word": "two"}
    assert made == EveryKind(**plain)
    assert {name: type(getattr(made, name)) for name in plain} == {name: type(value) for name, value in plain.items()}
    assert type(EveryKind(positive=2).positive) is float
    assert [type(each) for each in EveryKind(place=[1, 2]).place] == [float, float]


def test_a_number_is_a_tuple_of_one_and_layers_may_be_none():
    assert EveryKind(layers=8) == EveryKind(layers=(np.int64(8),))
    assert EveryKind(place=5).place == (5.0,)
    assert EveryKind(maybe=None, place=None, layers=[]).layers == ()


@checked
def area(width: Annotated[int, Ge(1)], height: Annotated[float, Gt(0)] = -1, *rest: object, unit: Literal["m"] = "m"):
    """Return the arguments."""
    return width, height, rest, unit


def test_arguments_are_checked_and_converted():
    assert area(np.int64(2), 3, None, "x") == (2, 3.0, (None, "x"), "m")
    assert {type(each) for each in area(np.int64(2), 3)[:2]} == {int, float}
    assert area(width=1) == (1, -1, (), "m")  # a default is not checked
    assert str(inspect.signature(area)) == str(inspect.signature(area.__wrapped__))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: area(0), ConfigError, "width must be a whole number of at least 1, got 0. Set --width."),
        (lambda: area(1, height=True), ConfigError, "height must be a number greater than 0, got True. Set --height."),
        (lambda: area(1, unit="cm"), UnknownNameError, "unknown unit 'cm'. ... Known: m. Set --unit."),
        (area, TypeError, "width"),
        (lambda: EveryKind(word="onee"), UnknownNameError, "unknown word 'onee'. Did you mean 'one'? ... Set --word."),
        (lambda: EveryKind(name="neat"), UnknownNameError, "unknown name 'neat'. Did you mean 'near'? ... Set --name."),
        (lambda: EveryKind(whole=2**63), ConfigError, "whole must be less than 2**63, got 92 ... Set --whole"),
        (lambda: EveryKind(positive=10**400), ConfigError, "positive must be less than 2**63, got ... Set --positive"),
        (lambda: EveryKind(layers=(8, 10**30)), ConfigError, "layers must be less than 2**63, got ... Set --net"),
    ],
)
def test_what_is_out_of_range_is_refused(call, error, message):
    with raises(error, message):
        call()


def test_every_setting_has_a_text_a_range_and_a_default():
    settings = known_settings()
    for name, setting in settings.items():
        assert setting.text.endswith("."), name
        assert name == "env" or setting.checked(setting.default) == setting.default, name
        if setting.item in (int, float):
            with pytest.raises(ConfigError):
                setting.checked((-2000,) if setting.kind is tuple else -1)
    assert len({each.flag for each in settings.values()}) == len(settings)
