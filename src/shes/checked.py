"""`checked`: the arguments of a function are checked as settings are, by their annotations."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar, get_type_hints

from shes.settings import Setting, described

F = TypeVar("F", bound=Callable[..., Any])


def checked(function: F) -> F:
    """Return `function`, or the class, which now checks the arguments whose annotations say what is allowed.

    A call raises as `Setting.checked` does, which also converts the values.
    """
    if isinstance(function, type):
        function.__init__ = checked(function.__init__)
        return function  # type: ignore[return-value] - it is of its own type
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs)
        for name, parameter in _parameters(function).items():
            if name in given.arguments:
                given.arguments[name] = parameter.checked(given.arguments[name])
        return function(*given.args, **given.kwargs)

    return call  # type: ignore[return-value] - of the same signature


@cache
def _parameters(function: Callable[..., Any]) -> dict[str, Setting]:
    hints = get_type_hints(function, include_extras=True)
    found = {name: described(name, hint, function) for name, hint in hints.items()}
    return {name: parameter for name, parameter in found.items() if parameter.notes}
