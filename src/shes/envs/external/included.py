"""The external environments by name: those of Gymnasium-Robotics, and those that users register."""

from __future__ import annotations

from shes.envs.external.environment import ExternalEnvironment
from shes.envs.root import yaw
from shes.errors import ConfigError
from shes.registry import Registry

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


def _check(_kind: str, environment: ExternalEnvironment) -> None:
    if not callable(environment.source) and not isinstance(environment.source, str):
        raise ConfigError(
            f"make must be a Gymnasium id or a function that returns an environment, got {environment.source!r}."
        )
    if environment.locate is not None and not callable(environment.locate):
        raise ConfigError(f"locate must be a function of an observation and its info, got {environment.locate!r}.")


EXTERNAL_ENVIRONMENTS: Registry[ExternalEnvironment] = Registry(
    "environment", INCLUDED, fix="See `shes envs`.", check=_check
)
"""Every external environment with a name; `shes.register_external` adds to it."""
