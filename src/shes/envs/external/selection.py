"""How a description says where something is: indices in the flat observation, or keys of observation or `info`.

A selection is one item or several; an item is

- a whole number or `"START:STOP"`: places in the flat observation;
- a key of a dict observation or, where the observation has no such key, of `info`: all its values, flat;
- `"KEY[I]"` or `"KEY[START:STOP]"`: some of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from shes.envs.value_kinds import is_whole
from shes.errors import ConfigError
from shes.types import IntArray

__all__ = ["Places", "Selection", "check_selection"]

Selection: TypeAlias = int | str | Sequence[int | str]

_SLICE = re.compile(r"(\d+):(\d+)")
_KEYED = re.compile(r"([^\[\]]+?)(?:\[(\d+)(?::(\d+))?\])?")
_EXAMPLES = 'for example [0, 1], "0:27", "achieved_goal" or "observation[1:5]"'


def check_selection(name: str, selection: Any) -> tuple[int | str, ...]:
    """Return `selection` as a tuple of items.

    Raises:
        ConfigError: It is none.
    """
    is_one = isinstance(selection, int | np.integer | str)
    items: list[Any] = [selection] if is_one else list(selection) if _is_sequence(selection) else [None]
    for item in items:
        is_index = is_whole(item) and item >= 0
        if not is_index and not (isinstance(item, str) and _KEYED.fullmatch(item)):
            raise ConfigError(f"{name} must be indices or keys, {_EXAMPLES}; got {selection!r}.")
    return tuple(item if isinstance(item, str) else int(item) for item in items)


def _is_sequence(selection: Any) -> bool:
    return isinstance(selection, Sequence) or (isinstance(selection, np.ndarray) and selection.ndim == 1)


@dataclass(frozen=True)
class Places:
    """Where the values of observation and `info` lie in one row: the flat observation, behind it those of `info`."""

    observation_size: int
    """Values of the flat observation, O."""
    keys: Mapping[str, tuple[int, int]]
    """Where the keys of a dict observation begin and end in it."""
    info: Mapping[str, Any]
    """What `info` held after a reset."""

    def columns(self, name: str, selection: Sequence[int | str], info_keys: dict[str, int] | None) -> IntArray:
        """Return the columns of `selection`; keys of `info` that it needs are added to `info_keys`, with their sizes.

        Args:
            name: The field of the description, for messages.
            selection: What `check_selection` returned.
            info_keys: Keys of `info` so far, in the order of their columns; None where only the observation may serve.

        Raises:
            ConfigError: A key is missing, its values are no numbers, an index is out of range, or a value is named
                twice.
        """
        found: list[int] = []
        for item in selection:
            numbers = _SLICE.fullmatch(item) if isinstance(item, str) else None
            if isinstance(item, int):
                found += self._cut(name, item, 0, self.observation_size, (item, item + 1))
            elif numbers:
                found += self._cut(name, item, 0, self.observation_size, (int(numbers[1]), int(numbers[2])))
            else:
                found += self._keyed(name, item, info_keys)
        if len(set(found)) < len(found):
            raise ConfigError(f"{name} must name every value once, got {list(selection)}, which are {found}.")
        return np.array(found, dtype=np.int64)

    def _keyed(self, name: str, item: str, info_keys: dict[str, int] | None) -> range:
        match = _KEYED.fullmatch(item)
        assert match is not None
        key, first, last = match.groups()
        if key in self.keys:
            start, stop = self.keys[key]
        elif info_keys is not None and key in self.info:
            start, stop = self._enter(name, key, info_keys)
        else:
            raise ConfigError(self._no_such_key(name, key, may_be_info=info_keys is not None))
        if first is None:
            return range(start, stop)
        bounds = (int(first), int(first) + 1 if last is None else int(last))
        return self._cut(name, item, start, stop - start, bounds)

    def _enter(self, name: str, key: str, info_keys: dict[str, int]) -> tuple[int, int]:
        """Give the values of `info[key]` columns behind those that there are."""
        value = np.asarray(self.info[key])
        if not np.issubdtype(value.dtype, np.number):
            raise ConfigError(f"{name}: info[{key!r}] must hold numbers, and is {self.info[key]!r}.")
        info_keys.setdefault(key, value.size)
        before = list(info_keys).index(key)
        start = self.observation_size + sum(list(info_keys.values())[:before])
        return start, start + value.size

    @staticmethod
    def _cut(name: str, item: int | str, start: int, size: int, bounds: tuple[int, int]) -> range:
        """Return the columns within `bounds` of the `size` values from column `start`."""
        first, last = bounds
        if not first < last <= size:
            raise ConfigError(f"{name}: {item!r} is out of range: there are {size} values, with indices from 0.")
        return range(start + first, start + last)

    def _no_such_key(self, name: str, key: str, *, may_be_info: bool) -> str:
        observed = f"keys {', '.join(map(repr, self.keys))}" if self.keys else "no keys: it is an array, use indices"
        of_info = f"; info has {', '.join(map(repr, self.info)) or 'no keys'} after a reset" if may_be_info else ""
        return f"{name}: there is no {key!r}. The observation has {observed}{of_info}."
