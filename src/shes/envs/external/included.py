"""Descriptions of environments of others: those that come with SHES, and those that users add."""

from __future__ import annotations

from shes.envs.external.description import ExternalDescription

__all__ = ["EXTERNAL_ENVIRONMENTS", "READY"]

READY: dict[str, ExternalDescription] = {
    # Observation: z, quaternion, 8 joints; 14 velocities; contact forces.
    "robotics-ant-maze": ExternalDescription(
        id="AntMaze_UMaze-v5",
        position=("achieved_goal",),
        heading=("observation[1:5]",),
        proprioception=("observation[0:27]",),
        primitive_view=("observation",),
        score="success",
    ),
    # Observation: x, y, their velocities.
    "robotics-point-maze": ExternalDescription(
        id="PointMaze_UMaze-v3",
        position=("achieved_goal",),
        primitive_view=("observation",),
        score="success",
    ),
}
"""Gymnasium-Robotics' mazes, for the extra `robotics`."""

EXTERNAL_ENVIRONMENTS: dict[str, ExternalDescription] = dict(READY)
"""The external environments by name; `shes.register_external_environment` adds to them."""
