"""The function that makes a worker, on its way to another process."""

from __future__ import annotations

import pickle
import sys
from contextlib import suppress
from pathlib import Path

import cloudpickle

from shes.backends.backend import WorkerFactory
from shes.errors import ConfigError, WorkerError


def pickle_factory(factory: WorkerFactory) -> bytes:
    """Return `factory` pickled. Classes defined in the caller's script are pickled by value.

    Raises:
        ConfigError: An object that it refers to cannot be pickled.
    """
    try:
        return cloudpickle.dumps(factory)
    except Exception as error:
        raise ConfigError(
            f"the work cannot be sent to worker processes: {error}. Move what your own class refers to into a module "
            "beside your script, which workers import, or set --backend serial."
        ) from error


def unpickle_factory(pickled: bytes) -> WorkerFactory:
    """Return the function that creates the worker; raise WorkerError if a module that it needs cannot be imported."""
    try:
        return pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise WorkerError(
            f"a worker process cannot import a module that its work needs: {error}. Put the folder of that module on "
            "PYTHONPATH, install the module, or set --backend serial."
        ) from error


def import_path() -> list[str]:
    """Return the import path of this process, on which workers find the modules of the caller's classes.

    Workers import these modules rather than receive them by value, so that the modules' own imports work as well.
    """
    path = [entry for entry in sys.path if entry]
    # An empty entry is the working directory: of a notebook, of `python -c`. Workers search it last, so that no file
    # there replaces a module of the standard library. It is resolved now, because it may change later.
    if len(path) < len(sys.path):
        with suppress(FileNotFoundError):
            path.append(str(Path.cwd()))
    return path
