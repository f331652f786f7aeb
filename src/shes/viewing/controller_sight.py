"""The inputs of a controller in words, before normalisation."""

from __future__ import annotations

import re

import numpy as np

from shes.envs.episode_batch import EpisodeBatch
from shes.hierarchy.views import View

_MOST_LISTED = 12
"""Number of inputs up to which each is listed; of more, those whose names begin with one word are summed up."""
_FEW_ALIKE = 3
"""Number of inputs that begin with one word, such as those of the target, up to which they are listed all the same."""


class ControllerSight:
    """The sight of the controller in the first episode of a batch."""

    def __init__(self, view: View, task: EpisodeBatch) -> None:
        """Look at `task` by `view`, that of the controller."""
        self._view, self._task = view, task
        self._names = view.names(task.observation_names)
        self._position = {task.observation_names[column] for column in task.position_columns}
        self._seen = np.zeros((1, len(self._names)))

    def look(self) -> tuple[str, ...]:
        """Return what the controller sees now, in words."""
        self._view.write(self._task.observe(), self._task.heading, self._seen)
        count = len(self._names)
        return (f"controller sees {count} value{'s' * (count != 1)}", *self._described())

    def _described(self) -> list[str]:
        """Return names and values of the inputs; of many, the largest of those that begin with one word."""
        kinds: dict[str, dict[str, float]] = {}
        for name, value in zip(self._names, self._seen[0].tolist(), strict=True):
            is_listed = len(self._names) <= _MOST_LISTED or name in self._position
            kinds.setdefault(name if is_listed else _first_word(name), {})[name] = value
        found: list[str] = []
        for word, kind in kinds.items():
            if len(kind) <= _FEW_ALIKE:
                found += [f"{name.replace('_', ' ')} {value:.2f}" for name, value in kind.items()]
            else:
                found.append(f"{len(kind)} of {word} up to {max(kind.values()):.2f}")
        return found


def _first_word(name: str) -> str:
    """Return the letters with which `name` begins; the whole name if there are none."""
    found = re.match(r"[^\W\d_]+", name)
    return found[0] if found else name
