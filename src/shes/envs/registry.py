"""The environments by name: a body and a task each. Adding one is one line here, or `register_environment`.

Environments of others, made by Gymnasium, have names too: `register_external_environment`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import Body
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external.description import ExternalDescription
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS, READY
from shes.envs.external.selection import Selection
from shes.envs.gymnasium_ids import register_ids
from shes.envs.tasks.fall import Fall
from shes.envs.tasks.flagrun import Flagrun
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.maze import Maze
from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.push import Push
from shes.envs.tasks.task import SimulatorFactory, Task
from shes.errors import ConfigError, UnknownNameError
from shes.registry import Registry, check_class, check_name_form
from shes.settings import Settings
from shes.sim.cpu import CpuSimulator

__all__ = [
    "ENVIRONMENTS",
    "Environment",
    "EnvironmentMaker",
    "check_description_name",
    "check_external_name",
    "find_description",
    "find_environment",
    "make_task",
    "register_environment",
    "register_external_environment",
]

_HOW_TO_REGISTER = "`shes envs` lists them. Register your own first: shes.register_environment, or --import MODULE."


class EnvironmentMaker(Protocol):
    """What makes episodes of an environment, ours or another's. Worker processes are sent this, not a name."""

    @property
    def options(self) -> type[TaskOptions]:
        """The class of its options."""
        ...

    @property
    def sets_goals(self) -> bool:
        """Whether it tells the robot where to go, so that a primitive learns in it without a controller."""
        ...

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> EpisodeBatch:
        """Return `num_episodes` episodes, whose physics is computed by what `simulator` makes.

        Raises:
            ConfigError: It brings its own physics, and `simulator` is not that of the CPU.
        """
        ...


class Environment(NamedTuple):
    """What a name stands for. Worker processes are sent this, not the name: they know no class of a user's script."""

    body: type[Body]
    task: type[Task]

    @property
    def options(self) -> type[TaskOptions]:
        """The class of its task's options."""
        return self.task.Options

    @property
    def sets_goals(self) -> bool:
        """Whether it tells the robot where to go, so that a primitive learns in it without a controller."""
        return self.task.sets_goals

    def with_body_options(self, options: Settings) -> Environment:
        """Return this environment with a body that has these options."""
        return self._replace(body=partial(self.body, options))  # type: ignore[arg-type] - it makes bodies, as a class

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> Task:
        """Return `num_episodes` episodes of this environment."""
        return self.task(self.body(), num_episodes, self.options() if options is None else options, simulator)


def _check_environment(kind: str, environment: Environment) -> None:
    """Refuse a body or a task that is not a complete class."""
    del kind
    check_class("body", environment.body, Body)
    check_class("task", environment.task, Task, num_arguments=4)


ENVIRONMENTS: Registry[Environment] = Registry(
    "environment",
    {
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
    },
    fix=_HOW_TO_REGISTER,
    check=_check_environment,
)


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
    _check_is_not_external(name)
    ENVIRONMENTS.register(name, Environment(body, task))
    register_ids(name, task.specs)


def register_external_environment(
    name: str,
    id: str,  # noqa: A002 - Gymnasium's own word
    *,
    position: Selection,
    heading: Selection = (),
    proprioception: Selection = (),
    primitive_view: Selection = (),
    score: str = "return",
    kwargs: Mapping[str, Any] | None = None,
) -> None:
    """Make an environment of Gymnasium known as environment `name`, in this process; a run's folder keeps all of it.

    ```python
    shes.register_external_environment(
        "wide-maze", "AntMaze_Open-v5", position="achieved_goal", heading="observation[1:5]", score="success"
    )
    shes.train("wide-maze")
    ```

    Where something is: indices in the flat observation (`[0, 1]`, `"0:27"`), a key of a dict observation or of `info`
    (`"achieved_goal"`), or some of a key's values (`"observation[1:5]"`); or a list of these. Whether the environment
    has them there is looked at when it is first made: when training begins.

    Args:
        name: Lower-case words joined by `-`.
        id: Its id in Gymnasium. Import what registers it first; Gymnasium-Robotics is imported by itself.
        position: Where x and y of the robot are, in metres.
        heading: Where its yaw is in radians, or its quaternion w x y z; 0 if nothing is given.
        proprioception: The robot's own part of the observation: what the primitive sees with
            `--primitive-view proprioception`, and one that `--primitive` brings if it was trained so. The same as
            `primitive_view` if nothing is given.
        primitive_view: What of the observation the primitive sees otherwise; all of it if nothing is given.
        score: `return`, or `success` by what `info` reports at the end, under `success` or `is_success`.
        kwargs: Arguments of `gymnasium.make`, as JSON holds them.

    Raises:
        ConfigError: A value is not allowed, or the name is malformed or taken.
        UnknownNameError: `score` is not known.
    """
    check_external_name(name)
    if name in READY:
        raise ConfigError(f"environment {name!r} comes with SHES: it is {READY[name].id}. Choose another name.")
    EXTERNAL_ENVIRONMENTS[name] = ExternalDescription.from_dict(
        {
            "id": id,
            "position": position,
            "heading": heading,
            "proprioception": proprioception,
            "primitive_view": primitive_view,
            "score": score,
            "kwargs": {} if kwargs is None else kwargs,
        }
    )


def check_external_name(name: str) -> None:
    """Refuse a name that an external environment cannot have.

    Raises:
        ConfigError: It is malformed, or that of an environment of our own.
    """
    check_name_form("environment", name)
    if name in ENVIRONMENTS:
        raise ConfigError(f"environment {name!r} is one of our own already. Choose another name.")


def check_description_name(name: str, description: ExternalDescription) -> None:
    """Refuse a name that a file's `description` cannot have.

    Raises:
        ConfigError: It is malformed, or that of another environment.
    """
    check_external_name(name)
    known = EXTERNAL_ENVIRONMENTS.get(name, description)
    if known.id != description.id:
        raise ConfigError(f"environment {name!r} is Gymnasium's {known.id} already, not {description.id}.")


def _check_is_not_external(name: str) -> None:
    if name in EXTERNAL_ENVIRONMENTS:
        external = EXTERNAL_ENVIRONMENTS[name].id
        raise ConfigError(f"environment {name!r} is Gymnasium's {external} already. Choose another name.")


def find_description(name: str) -> ExternalDescription | None:
    """Return the description of environment `name`; None if it is one of our own.

    Raises:
        UnknownNameError: It is neither.
    """
    if name not in ENVIRONMENTS and name not in EXTERNAL_ENVIRONMENTS:
        raise UnknownNameError("environment", name, [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS], _HOW_TO_REGISTER)
    return EXTERNAL_ENVIRONMENTS.get(name)


def find_environment(name: str) -> Environment:
    """Return environment `name`.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    return ENVIRONMENTS.find(name)


def make_task(
    name: str, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
) -> Task:
    """Return `num_episodes` episodes of environment `name`.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    return ENVIRONMENTS.find(name).make(num_episodes, options, simulator)
