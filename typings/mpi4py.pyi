"""mpi4py is installed only with the extra `mpi`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
