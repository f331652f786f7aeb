"""What an external environment reports of its success: at every step, or at the end of an episode alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.envs.external.description import ExternalDescription
from shes.envs.value_kinds import is_switch
from shes.errors import ConfigError

__all__ = ["check_last_info", "read_success"]

_KEYS = ("success", "is_success")
"""What `info` calls the success of an episode; the first that there is counts."""


def read_success(info: Mapping[str, Any]) -> bool:
    """Return whether `info` reports success; False if it says nothing of it.

    Raises:
        ConfigError: It is no single truth value.
    """
    key = next((key for key in _KEYS if key in info), None)
    if key is None:
        return False
    value = info[key]
    if not is_switch(value) and np.size(value) != 1:
        raise ConfigError(f"info[{key!r}] must be one truth value, and is {value!r}.")
    return bool(value)


def check_last_info(description: ExternalDescription, info: Mapping[str, Any]) -> None:
    """Refuse the last `info` of an episode that its environment has ended, if success is the score and it lacks it.

    Raises:
        ConfigError: It has none of the keys.
    """
    if description.score == "success" and not any(key in info for key in _KEYS):
        names = " nor ".join(map(repr, _KEYS))
        keys = ", ".join(map(repr, info)) or "nothing"
        raise ConfigError(
            f'{description.id}: its score cannot be "success": info at the end of an episode has neither {names}, '
            f'only {keys}. Take score = "return".'
        )
