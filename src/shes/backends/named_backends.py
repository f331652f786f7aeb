"""The backends by name. Adding one takes a file and a line here."""

from __future__ import annotations

from shes.backends.backend import Backend, SerialBackend
from shes.backends.mpi import MpiBackend
from shes.backends.processes import ProcessesBackend
from shes.backends.ray import RayBackend
from shes.options import subclass_of
from shes.registry import Registry

BACKENDS: Registry[type[Backend]] = Registry(
    "backend",
    {"processes": ProcessesBackend, "serial": SerialBackend, "ray": RayBackend, "mpi": MpiBackend},
    fix="Set --backend.",
    check=subclass_of(Backend, num_arguments=2, takes_options=True),
)
"""Backends by name: the choices of `--backend`."""
