"""Presets: starting values of a run's settings. An algorithm brings its own beside those here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Values by the name of a setting. Those of settings that a run does not have are ignored."""

    values: Mapping[str, Any] = field(default_factory=dict)
    """Values in every environment."""
    per_environment: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Further values by the name of the environment."""

    def of(self, env: str) -> dict[str, Any]:
        """Return the values in environment `env`."""
        return {**self.values, **self.per_environment.get(env, {})}


PRESETS: Mapping[str, Preset] = {
    # Learns visibly on a few cores: the default settings.
    "laptop": Preset(
        values={"evaluation_horizon": 500},
        per_environment={
            # The point reaches a goal in a second, not in two and a half, and its episodes cost little.
            "point-gather": {"horizon": 500, "generations": 80},
            # Cells of the point's maze are 1 m wide, those of the ant's 4 m.
            "robotics-point-maze": {"goal_distance": 1.0},
        },
    ),
    # Takes seconds: a test that does not learn.
    "smoke": Preset(
        values={"generations": 3, "horizon": 50, "hidden": (16,), "evaluation_interval": 2, "evaluation_episodes": 4}
    ),
}
"""The presets of every algorithm."""
