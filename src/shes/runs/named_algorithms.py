"""The registry of learning algorithms. Adding one takes a line here, or a call of `register_algorithm`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from shes.algorithms.contract import PRESETS, Algorithm
from shes.baselines.hiro import HIRO
from shes.baselines.td3 import TD3
from shes.errors import ConfigError
from shes.evolution.strategies import SES, SHES
from shes.options import check_options
from shes.registry import Registry, check_class, full_name

TAKEN_SECTIONS = frozenset({
    "run", "workers", "environment", "body", "episodes", "evaluation",
    "algorithm", "evaluation_steps", "from_dict", "having", "level_names", "numbers", "of", "sections",
    "settings", "to_dict", "values",
})  # fmt: skip
"""Names that a section of an algorithm cannot have: sections of every run, and attributes of `TrainConfig`."""


def _check_algorithm(kind: str, cls: Any) -> None:
    """Raise ConfigError if an algorithm, or the one that stands in for it, is incomplete or takes a name."""
    check_class(kind, cls, Algorithm, num_arguments=1)
    for section, settings in cls.sections.items():
        if section in TAKEN_SECTIONS:
            raise ConfigError(
                f"{kind} {full_name(cls)} has a section {section!r}, a name that is taken. Choose another name."
            )
        check_options(settings)
    if cls.without_controller not in (None, cls):  # a subclass that stands in inherits itself
        _check_algorithm(kind, cls.without_controller)


ALGORITHMS: Registry[type[Algorithm[Any]]] = Registry(
    "algorithm",
    {"shes": SHES, "es": SES, "hiro": HIRO, "td3": TD3},
    fix="Set --algorithm; register your own first: shes.register_algorithm, or --import MODULE.",
    check=_check_algorithm,
)
"""Algorithms by name: the choices of `--algorithm`."""


def register_algorithm(name: str, algorithm: type[Algorithm[Any]]) -> None:
    """Register `algorithm` as `--algorithm name` in this process.

    ```python
    shes.register_algorithm("random-search", RandomSearch)
    shes.train("point-gather", algorithm="random-search")
    ```

    A run folder stores only the name. In another process, register the algorithm again before `resume`, `evaluate` or
    `load`; on the command line, use `--import MODULE`.

    Args:
        name: Lower-case words joined by `-` or `_`.
        algorithm: A complete subclass of `Algorithm`, made from one argument, the `Problem`.
    """
    ALGORITHMS.register(name, algorithm)


def find_algorithm(name: str, *, sets_goals: bool = False) -> type[Algorithm[Any]]:
    """Return the algorithm called `name`. `sets_goals` says whether the environment itself sets goals."""
    found = ALGORITHMS.find(name)
    return found.without_controller or found if sets_goals else found


def algorithm_classes() -> tuple[type[Algorithm[Any]], ...]:
    """Return every algorithm, including the substitutes in environments that set goals."""
    return tuple(each for cls in ALGORITHMS.values() for each in (cls, cls.without_controller) if each is not None)


class _PresetNames(Iterable[str]):
    """The names at the time of asking, because an algorithm may be registered later."""

    def __iter__(self) -> Iterator[str]:
        presets = (PRESETS, *(cls.presets for cls in algorithm_classes()))
        return iter(dict.fromkeys(name for each in presets for name in each))


PRESET_NAMES = _PresetNames()
"""Names of the presets of every algorithm, and of those that a registered algorithm brings."""
