"""JAX is installed only with the extra `hiro`."""

from typing import Any, TypeAlias

from jax import numpy as numpy

Array: TypeAlias = Any

def __getattr__(name: str) -> Any: ...
