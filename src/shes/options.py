"""Options: settings that a registered class brings, such as the momentum of an optimizer.

A class brings settings by being a subclass of `Settings`, or by an attribute `Options` that is one:

```python
@dataclass(frozen=True, kw_only=True)
class SGD(Optimizer, Settings):
    momentum: Annotated[float, Ge(0), Lt(1)] = 0.9
    "Momentum."
```

The first is for classes that are nothing but their values, such as rewards and optimizers; the second for classes whose
objects have a state and are made with other arguments: tasks, bodies and backends. An algorithm, which has many, sorts
its settings into `sections`.

Registering the class is enough: its options become settings of the section in which the class can be chosen. An option
has a name of its own; classes of one registry may share an option if its type, default and range are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, field, make_dataclass
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

from shes.errors import ConfigError
from shes.registry import Registry, check_class, full_name
from shes.settings import Choices, Needs, Setting, Settings, Shared, Unasked, setting_fields

__all__ = ["TAKEN", "check_options", "make", "options_of", "subclass_of", "with_options"]

T = TypeVar("T")

TAKEN = frozenset({
    "debug", "env", "help", "help_all", "import", "json", "listener", "out", "path", "preset", "progress", "run",
    "seed", "settings", "sweep", "workers",
})  # fmt: skip
"""Names that an option cannot have: arguments of `shes.train` and `shes.resume`, and flags of their commands."""


def make(registry: Registry[type[T]], name: str, values: Mapping[str, Any]) -> T:
    """Return an object of the class registered as `name`, with those of `values` that are its own settings.

    Raises:
        UnknownNameError: There is no such class.
        ConfigError: A value is not allowed.
    """
    cls: Any = registry.find(name)
    made: Any = cls.of(values) if issubclass(cls, Settings) else cls()
    return made


def options_of(cls: Any) -> dict[str, Setting]:
    """Return the options of a registered class by name."""
    options = getattr(cls, "Options", cls)
    is_settings = isinstance(options, type) and issubclass(options, Settings)
    return setting_fields(options) if is_settings else {}


def subclass_of(
    contract: type, num_arguments: int = 0, *, takes_options: bool = False
) -> Callable[[str, object], None]:
    """Return the `check` for a registry of complete subclasses of `contract`; see `check_class` and `check_options`.

    `takes_options` says whether a class is constructed with its options as keyword arguments.
    """

    def check(kind: str, entry: object) -> None:
        check_options(entry)
        check_class(kind, entry, contract, num_arguments, tuple(options_of(entry)) if takes_options else ())

    return check


def check_options(cls: Any) -> None:
    """Check the options of a class.

    Raises:
        ConfigError: An option has an unsupported type, no default, or a name that is taken.
    """
    for name, option in options_of(cls).items():
        if option.default is MISSING:
            raise ConfigError(f"option {name!r} of {full_name(option.owner)} has no default. Give it one.")
        if name in TAKEN or hasattr(Settings, name):
            raise ConfigError(
                f"option {name!r} of {full_name(option.owner)} has a name that is taken by an argument or a flag of "
                "SHES. Choose another name."
            )


def with_options(sections: Mapping[str, type[Settings]]) -> dict[str, type[Settings]]:
    """Return `sections` with the options of the classes that can be chosen in them.

    An option belongs to the settings section of the first setting that selects its class. It needs one of the choices
    that have it.

    Raises:
        ConfigError: An option has the name of another setting.
    """
    section_of = {name: section for section, cls in sections.items() for name in setting_fields(cls)}
    homes: dict[str, _Home] = {}
    needs: dict[str, dict[str, tuple[str, ...]]] = {}
    for section, setting, registry in _choosing(sections):
        for choice, entry in registry.items():
            for name, option in options_of(entry).items():
                if name in section_of and not option.has(Shared):
                    raise ConfigError(
                        f"{name!r} is an option of {registry.kind} {choice!r}, but already a setting of section "
                        f"{section_of[name]!r}. Choose another name for the option."
                    )
                if name not in section_of and not option.has(Unasked):
                    home = homes.setdefault(name, _Home(section, registry, choice, option))
                    home.check_same(registry, choice, option)
                    choices = needs.setdefault(name, {})
                    choices[setting.name] = (*choices.get(setting.name, ()), choice)
    added: dict[str, list[tuple[Setting, tuple[Needs, ...]]]] = {section: [] for section in sections}
    for name, home in homes.items():
        added[home.section].append((home.option, tuple(Needs(*each) for each in needs[name].items())))
    return {section: _extended(cls, tuple(added[section])) for section, cls in sections.items()}


class _Home(NamedTuple):
    """Where an option belongs: the section, and the first choice that has the option."""

    section: str
    registry: Registry[Any]
    choice: str
    option: Setting

    def check_same(self, registry: Registry[Any], choice: str, option: Setting) -> None:
        """Raise ConfigError if `option`, of another choice with an option of this name, is another one."""
        if registry is self.registry and option.definition == self.option.definition:
            return
        fix = "Give both the same type, default and range, or choose" if registry is self.registry else "Choose"
        raise ConfigError(
            f"{option.name!r} is an option of {self.registry.kind} {self.choice!r} and a different one of "
            f"{registry.kind} {choice!r}. {fix} another name for one of them."
        )


def _choosing(sections: Mapping[str, type[Settings]]) -> Iterator[tuple[str, Setting, Registry[Any]]]:
    """Yield each setting that chooses a registered class, with its section and the registry."""
    for section, cls in sections.items():
        for setting in setting_fields(cls).values():
            for note in setting.notes:
                if isinstance(note, Choices) and isinstance(note.names, Registry):
                    yield section, setting, note.names


@cache
def _extended(section: type[Settings], options: tuple[tuple[Setting, tuple[Needs, ...]], ...]) -> type[Settings]:
    """Return `section` with `options` as further fields, each with the choices that it needs."""
    if not options:
        return section
    made = [
        (
            option.name,
            Annotated[get_type_hints(option.owner, include_extras=True)[option.name], *needs],
            field(default=option.default),
        )
        for option, needs in options
    ]
    owners = [option.owner for option, _ in options]
    namespace = {"__doc__": section.__doc__, "__module__": section.__module__, "_option_classes": owners}
    return make_dataclass(section.__name__, made, bases=(section,), namespace=namespace, frozen=True, kw_only=True)
