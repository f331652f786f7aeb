"""CuPy is installed only with the extra `gpu`, on machines with a card."""

from typing import Any

def __getattr__(name: str) -> Any: ...
