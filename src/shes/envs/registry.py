"""The environments by name: a body and a task each. Adding one is one line here."""

from __future__ import annotations

from shes.envs.ant import Ant
from shes.envs.body import Body
from shes.envs.gather import Gather
from shes.envs.point import Point
from shes.envs.task import SimulatorFactory, Task, TaskOptions
from shes.errors import UnknownNameError
from shes.sim.cpu import CpuSimulator

__all__ = ["ENVIRONMENTS", "check_name", "make_task"]

ENVIRONMENTS: dict[str, tuple[type[Body], type[Task]]] = {
    "ant-gather": (Ant, Gather),
    "point-gather": (Point, Gather),
}


def check_name(name: str) -> None:
    """Refuse an unknown environment.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    if name not in ENVIRONMENTS:
        raise UnknownNameError("environment", name, ENVIRONMENTS, "`shes envs` lists them.")


def make_task(
    name: str, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
) -> Task:
    """Return `num_episodes` episodes of environment `name`.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    check_name(name)
    body, task = ENVIRONMENTS[name]
    return task(body(), num_episodes, TaskOptions() if options is None else options, simulator)
