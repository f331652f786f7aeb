"""Options: settings that a registered class brings, such as the momentum of an optimizer.

A class brings settings by being a subclass of `Settings`, or by an attribute `Options` that is one:

```python
@dataclass(frozen=True, kw_only=True)
class SGD(Optimizer, Settings):
    momentum: Annotated[float, Ge(0), Lt(1)] = 0.9
    "Momentum."
```

Registering the class is enough: its options become settings of the room in which the class can be chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, make_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

from shes.registry import Registry
from shes.settings import Choices, Needs, Setting, Settings, Unasked, registered, setting_fields

__all__ = ["make", "options_of", "with_options"]

T = TypeVar("T")


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


def with_options(rooms: Mapping[str, type[Settings]]) -> dict[str, type[Settings]]:
    """Return `rooms` with the options of the classes that can be chosen in them.

    An option stands in the room of the first setting that can choose its class. It needs one of the choices that
    have it.
    """
    known = {name for cls in rooms.values() for name in setting_fields(cls)}
    homes: dict[str, tuple[str, Setting]] = {}
    needs: dict[str, dict[str, tuple[str, ...]]] = {}
    for room, cls in rooms.items():
        for setting in _choosing(cls):
            for choice, entry in _entries(setting).items():
                for name, option in options_of(entry).items():
                    if name not in known and not option.has(Unasked):
                        homes.setdefault(name, (room, option))
                        choices = needs.setdefault(name, {})
                        choices[setting.name] = (*choices.get(setting.name, ()), choice)
    added: dict[str, list[tuple[Setting, tuple[Needs, ...]]]] = {room: [] for room in rooms}
    for name, (room, option) in homes.items():
        added[room].append((option, tuple(Needs(*each) for each in needs[name].items())))
    return {room: _extended(cls, tuple(added[room])) for room, cls in rooms.items()}


@cache
def _choosing(room: type[Settings]) -> tuple[Setting, ...]:
    """Return the settings of `room` that choose a registered class."""
    return tuple(
        setting
        for setting in setting_fields(room).values()
        if any(isinstance(note, Choices) and isinstance(note.names, Registry) for note in setting.notes)
    )


def _entries(setting: Setting) -> dict[str, Any]:
    """Return the registered classes among the choices of a setting, by name."""
    names = (note.names for note in setting.notes if isinstance(note, Choices))
    return {name: entry for each in names for name, entry in registered(each).items()}


@cache
def _extended(room: type[Settings], options: tuple[tuple[Setting, tuple[Needs, ...]], ...]) -> type[Settings]:
    """Return `room` with `options` as further fields, each with the choices that it needs."""
    if not options:
        return room
    made = [
        (
            option.name,
            Annotated[get_type_hints(option.owner, include_extras=True)[option.name], *needs],
            field(default=option.default),
        )
        for option, needs in options
    ]
    owners = [option.owner for option, _ in options]
    namespace = {"__doc__": room.__doc__, "__module__": room.__module__, "_option_classes": owners}
    return make_dataclass(room.__name__, made, bases=(room,), namespace=namespace, frozen=True, kw_only=True)
