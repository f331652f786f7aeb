"""The learners by name. Adding one is one line here, or `register_algorithm`."""

from __future__ import annotations

from typing import Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.evolution.learners import SES, SHES, PrimitiveES
from shes.registry import Registry, subclass_of

__all__ = ["ALGORITHMS", "find_algorithm", "register_algorithm"]

ALGORITHMS: Registry[type[Algorithm[Any]]] = Registry(
    "algorithm",
    {"shes": SHES, "es": SES},
    fix="Set --algorithm; register your own first: shes.register_algorithm, or --import MODULE.",
    check=subclass_of(Algorithm, num_arguments=1),
)
"""What `--algorithm` may be."""

_PRIMITIVE_ALONE: dict[type[Algorithm[Any]], type[Algorithm[Any]]] = {SHES: PrimitiveES}
"""What learns instead where the environment itself sets the goals, as Flagrun does."""


def register_algorithm(name: str, algorithm: type[Algorithm[Any]]) -> None:
    """Make `algorithm` known as `--algorithm name`, in this process.

    ```python
    shes.register_algorithm("random-search", RandomSearch)
    shes.train("point-gather", algorithm="random-search")
    ```

    A run's folder keeps the name alone: register again before `resume`, `evaluate` or `load` in another process, on the
    command line by `--import MODULE`.

    Args:
        name: Lower-case words joined by `-` or `_`.
        algorithm: A complete subclass of `Algorithm`, made from one argument, the `Problem`.

    Raises:
        ConfigError: The class is none or not complete, or the name is malformed or stands for another class.
    """
    ALGORITHMS.register(name, algorithm)


def find_algorithm(name: str, *, sets_goals: bool = False) -> type[Algorithm[Any]]:
    """Return the learner of this name, for an environment that sets goals itself or does not.

    Raises:
        UnknownNameError: `name` is not in `ALGORITHMS`.
    """
    found = ALGORITHMS.find(name)
    return _PRIMITIVE_ALONE.get(found, found) if sets_goals else found
