"""The external environments by name: those of Gymnasium-Robotics, and those that users register."""

from __future__ import annotations

from shes.envs.external.environment import ExternalEnvironment
from shes.envs.root import yaw

__all__ = ["EXTERNAL_ENVIRONMENTS", "INCLUDED"]

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

EXTERNAL_ENVIRONMENTS: dict[str, ExternalEnvironment] = dict(INCLUDED)
"""Every external environment with a name; `shes.register_external` adds to it."""
