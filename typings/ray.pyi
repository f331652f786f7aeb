"""Ray is installed only with the extra `ray`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
