"""The environments by name: the built-in ones, those that users register, and those that Gymnasium makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pkgutil import resolve_name
from typing import Any, NamedTuple, TypeAlias

import gymnasium
import numpy as np

from shes.envs.bodies.body import Body, yaw
from shes.envs.bodies.robot import Robot, RobotOptions
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external_reader import Locate
from shes.envs.external_task import ExternalEnvironment
from shes.envs.gymnasium_ids import BUILTIN_ENVIRONMENTS, SPECS_OF, gymnasium_id, register_ids
from shes.envs.tasks.task import SimulatorFactory, Task, TaskOptions
from shes.errors import ConfigError, ShesError, UnknownNameError
from shes.options import subclass_of
from shes.registry import Registry
from shes.settings import Settings
from shes.sim.simulator import CpuSimulator
from shes.types import Listing, Table, is_whole

GYMNASIUM = "gymnasium:"
"""Prefix of an environment name that is followed by a Gymnasium id."""
_HOW_TO_REGISTER = (
    "`shes envs` lists them; gymnasium:ID is one of Gymnasium. Register your own first: shes.register_environment, "
    "shes.register_external, or --import MODULE."
)
_REST_S = 2.0  # seconds for which a robot is watched


class Environment(NamedTuple):
    """A body and a task."""

    body: type[Body]
    task: type[Task]

    has_own_physics = False
    """Whether the environment brings its own physics: it runs on the CPU only, and episodes cannot be branched."""

    def with_options(self, values: Mapping[str, Any]) -> Environment:
        """Return this environment with a body made from its options among `values`, if it has some."""
        own = self.body.Options
        if own is Settings:
            return self
        return self._replace(body=self.body.maker(own.of(values)))  # type: ignore[arg-type] - called like the class

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> Task:
        """Return `num_episodes` episodes of this environment."""
        return self.task(self.body(), num_episodes, self.task.Options() if options is None else options, simulator)


EnvironmentMaker: TypeAlias = Environment | ExternalEnvironment
"""Makes episodes of one environment. Worker processes receive this object, because they cannot look up its name."""


def _check_environment(_kind: str, environment: Environment) -> None:
    subclass_of(Body)("body", environment.body)
    subclass_of(Task, 4)("task", environment.task)


ENVIRONMENTS: Registry[Environment] = Registry(
    "environment",
    {
        name: Environment(resolve_name(f"shes.envs.bodies.{body}"), resolve_name(f"shes.envs.tasks.{task}"))
        for name, (body, task) in BUILTIN_ENVIRONMENTS.items()
    },
    fix=_HOW_TO_REGISTER,
    check=_check_environment,
)
"""Every environment that is a body and a task, by name."""


ROBOT_ENVIRONMENTS = {name.partition("-")[2]: Environment(Robot, each.task) for name, each in ENVIRONMENTS.items()}
"""The tasks by name, for a robot from a file, which the setting `robot` names."""


def with_robot(env: str, robot: object) -> str:
    """Return the environment of task `env` with `robot` if that comes with this package, else `env`."""
    named = f"{robot}-{env}"
    return named if env in ROBOT_ENVIRONMENTS and named in BUILTIN_ENVIRONMENTS else env


def _check_external(_kind: str, environment: ExternalEnvironment) -> None:
    make, locate = environment.source, environment.locate
    if not callable(make) and not isinstance(make, str):
        raise ConfigError(f"make must be a Gymnasium id or a function that returns an environment, got {make!r}.")
    if locate is not None and not callable(locate):
        raise ConfigError(f"locate must be a function of an observation and its info, got {locate!r}.")


INCLUDED = {
    "robotics-ant-maze": ExternalEnvironment(
        name="robotics-ant-maze",
        source="AntMaze_UMaze-v5",
        locate=lambda seen, _: (*seen["achieved_goal"].tolist(), float(yaw(seen["observation"][1:5]))),
        primitive_view=tuple(range(4, 109)),  # without the achieved and the desired goal, which come first
        is_scored_by_success=True,
    ),
    "robotics-point-maze": ExternalEnvironment(
        name="robotics-point-maze",
        source="PointMaze_UMaze-v3",
        locate=lambda seen, _: (*seen["achieved_goal"].tolist(), 0.0),
        primitive_view=tuple(range(4, 8)),
        is_scored_by_success=True,
    ),
}
"""Mazes of Gymnasium-Robotics, which the extra `robotics` installs."""
EXTERNAL_ENVIRONMENTS: Registry[ExternalEnvironment] = Registry(
    "environment", INCLUDED, fix="See `shes envs`.", check=_check_external
)
"""Every external environment with a name; `register_external` adds to it."""


def register_environment(name: str, body: type[Body], task: type[Task]) -> None:
    """Register `task` with `body` as environment `name`, here and in Gymnasium, for this process.

    ```python
    shes.register_environment("point-beacon", Point, Beacon)
    shes.train("point-beacon")
    ```

    A run folder stores the name only: register again before `resume`, `evaluate` or `load` in another process.

    Args:
        name: Lower-case words joined by `-`.
        body: The robot: a complete subclass of `Body`.
        task: The task: a complete subclass of `Task`.
    """
    if name in EXTERNAL_ENVIRONMENTS:
        raise ConfigError(f"environment {name!r} is already an external environment. Choose another name.")
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
    """Register a Gymnasium environment as environment `name`, for this process.

    ```python
    shes.register_external("wide-maze", "AntMaze_Open-v5", score="success")
    shes.train("wide-maze")
    ```

    A run folder stores the name only: register again before `resume`, `evaluate` or `load` in another process. An
    environment that is fully described by its id needs no registration: use the name `gymnasium:ID`.

    Args:
        name: Lower-case words joined by `-`; one that is taken by the same id, or by a function of the same full name,
            may be registered again.
        make: A Gymnasium id, whose package must be imported first (Gymnasium-Robotics is imported automatically); or a
            function that returns a new environment. To draw pictures it is called with `render_mode="rgb_array"`.
        locate: Returns (x, y, heading) of the robot, in metres and radians, from an observation and its `info`. By
            default they are read from MuJoCo: from the free joint of the first body, or from its slide joints along x
            and y. S-ES needs no position.
        primitive_view: Indices in the flat observation that the primitive sees; by default all but `desired_goal`.
        score: `return`, or `success`: 1 if `info` reports `success` or `is_success` at the end of the episode, else 0.
    """
    if name in ENVIRONMENTS or name in INCLUDED:
        raise ConfigError(f"environment {name!r} is already taken. Choose another name.")
    if primitive_view is not None and not all(map(is_whole, primitive_view)):
        raise ConfigError(f"primitive_view must be indices in the flat observation, got {primitive_view!r}.")
    if score not in ("return", "success"):
        raise UnknownNameError("score", str(score), ("return", "success"))
    EXTERNAL_ENVIRONMENTS[name] = ExternalEnvironment(
        name=name,
        source=make.removeprefix(GYMNASIUM) if isinstance(make, str) else make,
        locate=locate,
        primitive_view=None if primitive_view is None else tuple(primitive_view),
        is_scored_by_success=score == "success",
    )


def find_environment(name: str) -> EnvironmentMaker:
    """Return environment `name`: registered, or `gymnasium:` and an id, which is not looked up yet."""
    if name.startswith(GYMNASIUM):
        return ExternalEnvironment(name=name, source=name.removeprefix(GYMNASIUM))
    for known in (EXTERNAL_ENVIRONMENTS, ROBOT_ENVIRONMENTS, ENVIRONMENTS):
        if name in known:
            return known[name]
    _refuse_id(name)
    raise UnknownNameError("environment", name, [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS], _HOW_TO_REGISTER)


def _refuse_id(name: str) -> None:
    """Raise a ConfigError if `name` is a Gymnasium id, in any case, with or without its version."""
    ids: dict[str, str] = {}
    for env_id in gymnasium.registry:  # the latest version comes last
        ids |= {env_id.casefold(): env_id, env_id.casefold().rpartition("-v")[0]: env_id}
    env_id = ids.get(name.casefold())
    if env_id is None:
        return
    own = [(known, spec) for known, specs in SPECS_OF.items() for spec in specs if gymnasium_id(known, spec) == env_id]
    flags = f" --spec {own[0][1]}" if own and own[0][1] != "shes" else ""
    raise ConfigError(f"{name!r} is a Gymnasium id. Write {own[0][0] + flags if own else GYMNASIUM + env_id}.")


def list_environments(
    *,
    robot: str | None = None,
    motors: float | None = None,
    control_step: float = RobotOptions.control_step,
    robot_keyframe: str | None = None,
) -> Listing:
    """List the environments with their dimensions, rewards and scores, or what was understood of a robot's file.

    shes envs --robot robot.xml

    Args:
        robot: The robot's MJCF file, or menagerie:NAME: describe it instead.
        motors: Largest torque of a motor at each joint, for a file without actuators.
        control_step: Seconds of a control step.
        robot_keyframe: Keyframe of the file that is the home pose.
    """
    if robot is not None and with_robot("gather", robot) != "gather":
        raise ConfigError(f"robot {robot!r} comes with SHES, as in {robot}-gather: `shes envs` lists it. Name a file.")
    if robot is not None:
        options = RobotOptions(robot=robot, motors=motors, control_step=control_step, robot_keyframe=robot_keyframe)
        facts = Robot(options).describe() | {"at rest": _rest(options)}
        return Listing(facts, [f"{name}: {text}" for name, text in facts.items()])
    rows = [_describe(*named) for named in (*ENVIRONMENTS.items(), *EXTERNAL_ENVIRONMENTS.items())]
    shown = [
        (row["name"], row["task"], *map(str, [*row["observation"].values(), "", ""][:2]), str(row["action"] or ""))
        for row in rows
    ]
    tasks = {(row["task"], row["score"]): (row["task"], row["reward"], row["ends"], row["score"]) for row in rows}
    parts = (
        Table(("environment", "task", "observation", "hiro", "action"), shown),
        Table(("task", "reward of a step", "ends early", "score of an episode"), list(tasks.values())),
        *(row["about"] for row in rows if not row["observation"]),
        "In Gymnasium: shes/AntGather-v0, and shes/AntGatherHiro-v0 for --spec hiro. More: --json, and `make docs`.",
    )
    return Listing(rows, parts)


def _rest(options: RobotOptions) -> str:
    """Return how long the robot of `options` stands if every output is 0, in words."""
    task = ROBOT_ENVIRONMENTS["flagrun"]._replace(body=partial(Robot, options)).make(1)  # type: ignore[arg-type]
    task.reset(np.array([0]), [0])
    for step in range(1, round(_REST_S / task.step_s) + 1):
        task.step(np.array([0]), np.zeros((1, task.action_size)))
        if task.terminated[0] or task.diverged[0]:
            what = "its physics diverges" if task.diverged[0] else "it falls"
            return f"with outputs of 0 {what} after {step * task.step_s:.3g} s"
    return f"with outputs of 0 it stands for {_REST_S:g} s or longer"


def _describe(name: str, environment: EnvironmentMaker) -> dict[str, Any]:
    """Return the description of an environment, without sizes if it is an external one that cannot be made."""
    made: dict[str, EpisodeBatch] = {}
    if isinstance(environment, Environment):
        task, text = environment.task, environment.task.description
        made |= {spec: environment.make(1, TaskOptions(spec=spec)) for spec in task.specs}
        ids, words = [gymnasium_id(name, spec) for spec in task.specs], (task.name, text.reward, text.ends, text.score)
        about = " ".join((task.__doc__ or "").split("\n\n", maxsplit=1)[0].split())
    else:
        ids = [environment.source if isinstance(environment.source, str) else "made by a function"]
        words = ("external", "its own", "by its own rule", "success" if environment.is_scored_by_success else "return")
        about = f"Gymnasium's {ids[0]}"
        try:
            made["external"] = environment.make(1)
        except ShesError as error:
            about = str(error)
    return {
        "name": name,
        "gymnasium": ids,
        "observation": {spec: each.observation_size for spec, each in made.items()},
        "action": next((each.action_size for each in made.values()), None),
        **dict(zip(("task", "reward", "ends", "score"), words, strict=True)),
        "about": about,
    }
