"""Optax is installed only with the extra `hiro`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
