"""The registry of learning algorithms. Adding one takes a line here, or a call of `register_algorithm`."""

from __future__ import annotations

from typing import Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.evolution.learners import SES, SHES, PrimitiveES
from shes.algorithms.hiro.algorithm import HIRO, TD3
from shes.registry import Registry, subclass_of

ALGORITHMS: Registry[type[Algorithm[Any]]] = Registry(
    "algorithm",
    {"shes": SHES, "es": SES, "hiro": HIRO, "td3": TD3},
    fix="Set --algorithm; register your own first: shes.register_algorithm, or --import MODULE.",
    check=subclass_of(Algorithm, num_arguments=1),
)
"""Algorithms by name: the choices of `--algorithm`."""

_PRIMITIVE_ALONE: dict[type[Algorithm[Any]], type[Algorithm[Any]]] = {SHES: PrimitiveES}
"""Substitutes in environments that set the goals themselves, such as Flagrun."""


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

    Raises:
        ConfigError: The class is not a complete subclass, or the name is malformed or already taken.
    """
    ALGORITHMS.register(name, algorithm)


def find_algorithm(name: str, *, sets_goals: bool = False) -> type[Algorithm[Any]]:
    """Return the algorithm called `name`. `sets_goals` says whether the environment itself sets goals."""
    found = ALGORITHMS.find(name)
    return _PRIMITIVE_ALONE.get(found, found) if sets_goals else found


def learners() -> tuple[type[Algorithm[Any]], ...]:
    """Return every algorithm, including the substitutes in environments that set goals."""
    return (*ALGORITHMS.values(), *_PRIMITIVE_ALONE.values())
