import pytest

from shes.errors import ConfigError, UnknownNameError
from shes.registry import Registry, check_class
from tests.messages import raises


class Animal:
    legs: int

    def __init__(self, name="", *, weight=1.0):
        self.name = name


class Dog(Animal):
    legs = 4


class Bird(Animal):
    legs = 2


Weightless = type("Weightless", (Dog,), {"__init__": lambda _self, _name: None})


@pytest.fixture
def animals():
    def check(kind, entry):
        check_class(kind, entry, Animal, 1, ("weight",))

    return Registry("animal", {"dog": Dog}, fix="Set --animal.", check=check)


def test_a_registry_is_a_mapping_in_the_order_of_registration(animals):
    animals.register("bird", Bird)
    assert list(animals.items()) == [("dog", Dog), ("bird", Bird)]
    assert animals.find("dog") is Dog
    with pytest.raises(UnknownNameError):
        animals.find("dig")
    del animals["bird"]
    assert "bird" not in animals
    animals["bird"] = Bird


def test_a_class_defined_again_replaces_the_first(animals):
    again = type("Dog", (Animal,), {"__module__": Dog.__module__, "__qualname__": "Dog", "legs": 4})
    animals.register("dog", again)
    assert animals["dog"] is again


@pytest.mark.parametrize(
    ("name", "entry", "message"),
    [
        ("dog", Bird, "animal 'dog' is ... Dog already. Choose another name."),
        ("Big Dog", Dog, "animal name must be lower-case words of letters and digits, ... got 'Big Dog'"),
        (None, Dog, "animal name must be lower-case words ... got None"),
        ("own", Dog(), "an animal must be a subclass of ... Animal, got < ... not an object of it"),
        ("own", int, "must be a subclass of ... Animal, got <class 'int'>. Write class YourOwn(Animal)"),
        ("own", Animal, "Animal lacks legs. ... Animal says what each of them is: add them to your class"),
        ("own", Weightless, "cannot be constructed with 1 argument and weight: ... Change its __init__"),
    ],
)
def test_what_is_malformed_or_taken_is_refused(animals, name, entry, message):
    with raises(ConfigError, message):
        animals.register(name, entry)
    assert dict(animals) == {"dog": Dog}
