# For pyright: MuJoCo's compiled modules carry no types, so every name of theirs is Any.
from typing import Any

def __getattr__(name: str) -> Any: ...
