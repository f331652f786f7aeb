"""The environments by name: a body and a task each. Adding one is one line here, or `register_environment`."""

from __future__ import annotations

from typing import NamedTuple

from shes.envs.ant import Ant
from shes.envs.body import Body
from shes.envs.entries import check_class, check_name_is_free
from shes.envs.fall import Fall
from shes.envs.flagrun import Flagrun
from shes.envs.gather import Gather
from shes.envs.maze import Maze
from shes.envs.point import FallingPoint, Point
from shes.envs.push import Push
from shes.envs.task import SimulatorFactory, Task, TaskOptions
from shes.errors import UnknownNameError
from shes.sim.cpu import CpuSimulator

__all__ = ["ENVIRONMENTS", "Environment", "check_name", "find_environment", "make_task", "register_environment"]


class Environment(NamedTuple):
    """What a name stands for. Worker processes are sent this, not the name: they know no class of a user's script."""

    body: type[Body]
    task: type[Task]

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> Task:
        """Return `num_episodes` episodes of this environment."""
        return self.task(self.body(), num_episodes, TaskOptions() if options is None else options, simulator)


ENVIRONMENTS: dict[str, Environment] = {
    "ant-gather": Environment(Ant, Gather),
    "ant-maze": Environment(Ant, Maze),
    "ant-push": Environment(Ant, Push),
    "ant-fall": Environment(Ant, Fall),
    "ant-flagrun": Environment(Ant, Flagrun),
    "point-gather": Environment(Point, Gather),
    "point-maze": Environment(Point, Maze),
    "point-push": Environment(Point, Push),
    "point-fall": Environment(FallingPoint, Fall),
    "point-flagrun": Environment(Point, Flagrun),
}


def register_environment(name: str, body: type[Body], task: type[Task]) -> None:
    """Make `task` with `body` known as environment `name`, in this process; Gymnasium gets to know it too.

    ```python
    shes.register_environment("point-beacon", Point, Beacon)
    shes.train("point-beacon")
    ```

    A run's folder keeps the name alone: register again before `resume`, `evaluate` or `load` in another process.

    Args:
        name: Lower-case words joined by `-`.
        body: The robot: a complete subclass of `Body`.
        task: What it has to do: a complete subclass of `Task`.

    Raises:
        ConfigError: A class is none or not complete, or the name is malformed or stands for other classes.
    """
    environment = Environment(body, task)
    check_class("body", body, Body)
    check_class("task", task, Task, num_arguments=4)
    check_name_is_free("environment", name, environment, ENVIRONMENTS)
    ENVIRONMENTS[name] = environment
    from shes.envs.registration import register_all

    register_all()


def check_name(name: str) -> None:
    """Refuse an unknown environment.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    if name not in ENVIRONMENTS:
        fix = "`shes envs` lists them. Register your own first: shes.register_environment, or --import MODULE."
        raise UnknownNameError("environment", name, ENVIRONMENTS, fix)


def find_environment(name: str) -> Environment:
    """Return environment `name`.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    check_name(name)
    return ENVIRONMENTS[name]


def make_task(
    name: str, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
) -> Task:
    """Return `num_episodes` episodes of environment `name`.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    return find_environment(name).make(num_episodes, options, simulator)
