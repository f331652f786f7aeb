"""Options: settings that a registered class brings, such as the targets of a task.

A class that is nothing but its values, such as a reward, is itself a `Settings` dataclass. A class whose objects have a
state, such as a task, a body or a backend, has an attribute `Options` that is one. Registering the class is enough: its
options become settings of the section in which it can be chosen. Classes of one registry may share an option.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, replace
from typing import Any, NamedTuple, TypeVar

from shes.errors import ConfigError
from shes.registry import Registry, check_class, full_name
from shes.settings import Choices, Needs, Setting, Settings, Unasked, registered, setting_fields

T = TypeVar("T")

TAKEN = frozenset({
    "debug", "env", "help", "help_all", "import", "json", "like", "listener", "out", "path", "preset", "progress",
    "run", "seed", "settings", "sweep", "workers",
})  # fmt: skip
"""Names that an option cannot have: arguments of `shes.train` and `shes.resume`, and flags of their commands."""


def make(registry: Registry[type[T]], name: str, values: Mapping[str, Any]) -> T:
    """Return an object of the class registered as `name`, with those of `values` that are its own settings.

    A class may have a method `check_result(name)`, which raises ConfigError for a wrong result.
    """
    cls: Any = registry.find(name)
    made: Any = cls.of(values) if issubclass(cls, Settings) else cls()
    if hasattr(made, "check_result"):
        made.check_result(name)
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
    """Raise ConfigError if an option of a class has an unsupported type, no default, or a name that is taken."""
    for name, option in options_of(cls).items():
        whose = f"option {name!r} of {full_name(option.owner)}"
        if option.default is MISSING:
            raise ConfigError(f"{whose} has no default. Give it one.")
        if name in TAKEN or hasattr(Settings, name):
            raise ConfigError(f"{whose} has a name that is taken by an argument or a flag. Choose another name.")


def with_options(sections: Mapping[str, type[Settings]]) -> dict[str, dict[str, Setting]]:
    """Return the settings of each section by name: its fields, and the options of classes that it can choose.

    An option belongs to the section of the first setting that selects its class. It needs one of the choices that have
    it. Raise ConfigError if it has the name of another setting.
    """
    found = {
        section: {name: each for name, each in setting_fields(cls).items() if not each.has(Unasked)}
        for section, cls in sections.items()
    }
    homes = {name: section for section, own in found.items() for name in own}
    firsts: dict[str, _Option] = {}
    needs: dict[str, dict[str, tuple[str, ...]]] = {}
    for each in list(_options_in(found)):
        name = each.setting.name
        if name in homes:
            raise ConfigError(
                f"{name!r} is an option of {each.registry.kind} {each.choice!r}, but already a setting of section "
                f"{homes[name]!r}. Choose another name for the option."
            )
        first = firsts.setdefault(name, each)
        one, other = ((it.registry.kind, it.setting.hint, it.setting.default) for it in (first, each))
        if one != other:
            raise ConfigError(
                f"{name!r} is an option of {first.registry.kind} {first.choice!r} and a different one of "
                f"{each.registry.kind} {each.choice!r}. Choose another name for one of them. Only classes of one kind "
                "may share an option, of the same type, default and range."
            )
        choices = needs.setdefault(name, {})
        choices[each.chooser] = (*choices.get(each.chooser, ()), each.choice)
    for name, each in firsts.items():
        notes = (*each.setting.notes, *(Needs(*need) for need in needs[name].items()))
        found[each.section][name] = replace(each.setting, notes=notes)
    return found


class _Option(NamedTuple):
    """An option, and where it is found: the section, the setting that chooses its class, and the class."""

    section: str
    chooser: str
    registry: Any
    choice: str
    setting: Setting


def _options_in(settings: Mapping[str, Mapping[str, Setting]]) -> Iterator[_Option]:
    """Yield the options of every class that one of `settings`, by section, can choose."""
    for section, own in settings.items():
        for chooser in own.values():
            for note in chooser.all_of(Choices):
                for choice, cls in registered(note.names).items():
                    asked = (each for each in options_of(cls).values() if not each.has(Unasked))
                    yield from (_Option(section, chooser.name, note.names, choice, each) for each in asked)
