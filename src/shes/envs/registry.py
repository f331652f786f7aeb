"""The environments by name: a body and a task each. Adding one is one line here, or `register_environment`.

Environments of others, made by Gymnasium, have names too: `register_external`, or `gymnasium:` and an id.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.body import Body
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS, INCLUDED
from shes.envs.gymnasium_ids import SPECS_OF, find_id, gymnasium_id, register_ids
from shes.envs.tasks.fall import Fall
from shes.envs.tasks.flagrun import Flagrun
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.maze import Maze
from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.push import Push
from shes.envs.tasks.task import SimulatorFactory, Task
from shes.envs.value_kinds import is_whole
from shes.errors import ConfigError, UnknownNameError
from shes.registry import Registry, check_class, check_name_form
from shes.settings import Settings
from shes.sim.cpu import CpuSimulator

if TYPE_CHECKING:
    import gymnasium

    from shes.envs.external.reader import Locate

__all__ = [
    "ENVIRONMENTS",
    "GYMNASIUM",
    "Environment",
    "EnvironmentMaker",
    "find_environment",
    "make_task",
    "register_environment",
    "register_external",
]

_HOW_TO_REGISTER = (
    "`shes envs` lists them; gymnasium:ID is one of Gymnasium. Register your own first: shes.register_environment, "
    "shes.register_external, or --import MODULE."
)
GYMNASIUM = "gymnasium:"
"""What stands before an id of Gymnasium where the name of an environment may stand."""
_SCORES = ("return", "success")


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

    @property
    def has_own_physics(self) -> bool:
        """Whether its physics is no simulator of ours: it runs on the CPU alone, and its episodes have no branches."""
        ...

    @property
    def max_episode_steps(self) -> int | None:
        """Time limit that it brings, in training and evaluation; None if the preset says."""
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
    def has_own_physics(self) -> bool:
        """Return False: our simulators compute it."""
        return False

    @property
    def max_episode_steps(self) -> None:
        """Return None: the preset says how long its episodes are."""
        return

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
    if name in EXTERNAL_ENVIRONMENTS:
        raise ConfigError(f"environment {name!r} is one of Gymnasium already. Choose another name.")
    ENVIRONMENTS.register(name, Environment(body, task))
    register_ids(name, task.specs)


def register_external(
    name: str,
    make: str | Callable[..., gymnasium.Env[Any, Any]],
    *,
    locate: Locate | None = None,
    primitive_view: Sequence[int] | None = None,
    score: str = "return",
) -> None:
    """Make an environment of others known as environment `name`, in this process; Gymnasium makes it, or a function.

    ```python
    shes.register_external("wide-maze", "AntMaze_Open-v5", score="success")
    shes.train("wide-maze")
    ```

    A run's folder keeps the name alone: register again before `resume`, `evaluate` or `load` in another process. An
    environment that needs no more than its id needs no registration: it is called `gymnasium:ID`.

    Args:
        name: Lower-case words joined by `-`.
        make: Its id in Gymnasium, whose package you import first (Gymnasium-Robotics is imported by itself); or a
            function that returns a new environment. For pictures it is called with `render_mode="rgb_array"`.
        locate: Returns (x, y, heading) of the robot, in metres and radians, from an observation and its `info`. If
            none, they are read from MuJoCo: from the free joint of the first body, or from its slide joints along x
            and y. S-ES needs no position.
        primitive_view: Indices in the flat observation that the primitive sees; all but `desired_goal` if none.
        score: `return`, or `success`: 1 for what `info` reports at the end, under `success` or `is_success`.

    Raises:
        ConfigError: A value is not allowed, or the name is malformed or taken.
        UnknownNameError: `score` is not known.
    """
    check_name_form("environment", name)
    if name in ENVIRONMENTS or name in INCLUDED:
        raise ConfigError(f"environment {name!r} comes with SHES. Choose another name.")
    if not callable(make) and not isinstance(make, str):
        raise ConfigError(f"make must be an id of Gymnasium or a function that returns an environment, got {make!r}.")
    if locate is not None and not callable(locate):
        raise ConfigError(f"locate must be a function of an observation and its info, got {locate!r}.")
    view = None if primitive_view is None else tuple(primitive_view)
    if view is not None and not all(is_whole(index) for index in view):
        raise ConfigError(f"primitive_view must be indices in the flat observation, got {primitive_view!r}.")
    if score not in _SCORES:
        raise UnknownNameError("score", str(score), _SCORES)
    EXTERNAL_ENVIRONMENTS[name] = ExternalEnvironment(
        name=name,
        source=make.removeprefix(GYMNASIUM) if isinstance(make, str) else make,
        locate=locate,
        primitive_view=view,
        is_scored_by_success=score == "success",
    )


def find_environment(name: str) -> EnvironmentMaker:
    """Return environment `name`: one of our own, of others, or `gymnasium:` and an id, which is not looked up yet.

    Raises:
        UnknownNameError: There is none.
        ConfigError: It is an id of Gymnasium; the message says what to write.
    """
    if name.startswith(GYMNASIUM):
        return ExternalEnvironment(name=name, source=name.removeprefix(GYMNASIUM))
    if name in EXTERNAL_ENVIRONMENTS:
        return EXTERNAL_ENVIRONMENTS[name]
    if name not in ENVIRONMENTS:
        _refuse_id(name)
        raise UnknownNameError("environment", name, [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS], _HOW_TO_REGISTER)
    return ENVIRONMENTS[name]


def _refuse_id(name: str) -> None:
    """Refuse an id of Gymnasium where a name is meant.

    Raises:
        ConfigError: It is one, in whatever case, with or without its version.
    """
    env_id = find_id(name)
    for own, specs in SPECS_OF.items():
        for spec in specs:
            if gymnasium_id(own, spec) == env_id:
                flags = "" if spec == "shes" else f" --spec {spec}"
                raise ConfigError(f"{name!r} is an id of Gymnasium. Here it is called {own}{flags}.")
    if env_id is not None:
        raise ConfigError(f"{name!r} is an id of Gymnasium. Write {GYMNASIUM}{env_id}.")


def make_task(
    name: str, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
) -> Task:
    """Return `num_episodes` episodes of environment `name`, one of our own.

    Raises:
        UnknownNameError: `name` is not in `ENVIRONMENTS`.
    """
    return ENVIRONMENTS.find(name).make(num_episodes, options, simulator)
