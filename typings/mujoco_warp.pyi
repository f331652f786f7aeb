"""mujoco-warp is installed only with the extra `gpu`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
