"""The learners by name. Adding one is one line here, or `register_algorithm`."""

from __future__ import annotations

from typing import Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.evolution.learners import SES, SHES, PrimitiveES
from shes.envs.entries import check_class, check_name_is_free
from shes.errors import UnknownNameError

__all__ = ["ALGORITHMS", "check_algorithm", "find_algorithm", "register_algorithm"]

ALGORITHMS: dict[str, type[Algorithm[Any]]] = {"shes": SHES, "es": SES}
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
    check_class("algorithm", algorithm, Algorithm, num_arguments=1)
    check_name_is_free("algorithm", name, algorithm, ALGORITHMS)
    ALGORITHMS[name] = algorithm


def check_algorithm(name: str) -> None:
    """Refuse a name that is not known.

    Raises:
        UnknownNameError: `name` is not in `ALGORITHMS`.
    """
    if name not in ALGORITHMS:
        raise UnknownNameError(
            "algorithm",
            name,
            ALGORITHMS,
            "Set --algorithm; register your own first: shes.register_algorithm, or --import MODULE.",
        )


def find_algorithm(name: str, *, sets_goals: bool = False) -> type[Algorithm[Any]]:
    """Return the learner of this name, for an environment that sets goals itself or does not.

    Raises:
        UnknownNameError: `name` is not in `ALGORITHMS`.
    """
    check_algorithm(name)
    found = ALGORITHMS[name]
    return _PRIMITIVE_ALONE.get(found, found) if sets_goals else found
