import pytest

from shes.agents.goals import GOAL_ENCODINGS
from shes.agents.outputs import CONTROLLER_OUTPUTS
from shes.agents.rewards import PRIMITIVE_REWARDS
from shes.errors import ConfigError, UnknownNameError
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import FITNESS_SHAPINGS
from shes.registry import Registry, check_class

REGISTRIES = [
    CONTROLLER_OUTPUTS,
    FITNESS_SHAPINGS,
    GOAL_ENCODINGS,
    OPTIMIZERS,
    PERTURBATIONS,
    PRIMITIVE_REWARDS,
]
every_registry = pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.kind)


class Animal:
    legs: int

    def __init__(self, name="", *, weight=1.0):
        self.name = name


class Dog(Animal):
    legs = 4


class Bird(Animal):
    legs = 2


class Weightless(Dog):
    def __init__(self, name):
        super().__init__(name)


@pytest.fixture
def animals():
    def check(kind, entry):
        check_class(kind, entry, Animal, 1, ("weight",))

    return Registry("animal", {"dog": Dog}, fix="Set --animal.", check=check)


def test_a_registry_is_a_mapping_in_the_order_of_registration(animals):
    animals.register("bird", Bird)
    assert dict(animals) == {"dog": Dog, "bird": Bird}
    assert list(animals) == ["dog", "bird"]
    assert len(animals) == 2
    assert "cat" not in animals
    assert repr(animals).startswith("Registry('animal', {'dog':")


def test_an_entry_is_found_by_its_name(animals):
    assert animals.find("dog") is animals["dog"] is Dog


def test_an_unknown_name_is_refused_with_the_nearest_and_what_to_do(animals):
    with pytest.raises(
        UnknownNameError, match=r"unknown animal 'dig'\. Did you mean 'dog'\? Known: dog\. Set --animal\."
    ):
        animals.find("dig")
    with pytest.raises(UnknownNameError, match=r"unknown pet 'cat'\. Known: dog\. Buy one\."):
        animals.find("cat", kind="pet", fix="Buy one.")
    with pytest.raises(UnknownNameError, match=r"unknown animal '3'"):
        animals.find(3)


def test_the_same_class_defined_again_takes_the_place_of_the_first(animals):
    again = type("Dog", (Animal,), {"__module__": Dog.__module__, "__qualname__": "Dog", "legs": 4})
    animals.register("dog", again)
    assert animals["dog"] is again


def test_setting_an_item_registers_it(animals):
    animals["bird"] = Bird
    assert animals["bird"] is Bird
    with pytest.raises(ConfigError, match=r"animal 'dog' is .*Dog already"):
        animals["dog"] = Bird
    del animals["bird"]
    assert "bird" not in animals


@pytest.mark.parametrize(
    ("name", "entry", "message"),
    [
        ("dog", Bird, r"animal 'dog' is .*Dog already\. Choose another name\."),
        ("Big Dog", Dog, r"animal name must be lower-case words of letters and digits, .*got 'Big Dog'"),
        (None, Dog, r"animal name must be lower-case words .*got None"),
        ("own", Dog(), r"an animal must be a subclass of .*Animal, got <.*not an object of it"),
        ("own", int, r"must be a subclass of .*Animal, got <class 'int'>\. Write class YourOwn\(Animal\)"),
        ("own", Animal, r"Animal lacks legs\. .*Animal says what each of them is: add them to your class"),
        ("own", Weightless, r"cannot be constructed with 1 argument and weight: .*Change its __init__"),
    ],
)
def test_what_is_malformed_or_taken_is_refused(animals, name, entry, message):
    with pytest.raises(ConfigError, match=message):
        animals.register(name, entry)
    assert dict(animals) == {"dog": Dog}


@every_registry
def test_every_registry_refuses_what_is_no_class_of_its_kind(registry):
    before = dict(registry)
    with pytest.raises(ConfigError, match=rf"an? {registry.kind} must be a subclass of"):
        registry.register("own", int)
    assert dict(registry) == before


@every_registry
def test_every_registry_says_what_to_do_about_an_unknown_name(registry):
    with pytest.raises(UnknownNameError, match=rf"unknown {registry.kind} 'zzz'\. Known: .* Set --[a-z-]+\."):
        registry.find("zzz")
