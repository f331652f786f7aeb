# For pyright: the part of threadpoolctl that is used here.
from contextlib import AbstractContextManager
from typing import Any

def threadpool_limits(
    limits: int | dict[str, int] | None = None, user_api: str | None = None
) -> AbstractContextManager[Any]: ...
