"""Values of the evolution strategies in presets.

Source: SHES paper, Table I; docs/differences.md; docs/learning.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.contract import Preset

SES_PRESETS: Mapping[str, Preset] = {
    # Table I exactly; what it leaves open is as in the authors' code.
    "paper": Preset(
        values={
            "generations": 3000,
            "hidden": (256, 256, 256),
            "horizon": 500,
            "reset_noise": 0.0,
            "evaluation_episodes": 10,
            "population_size": 1000,
            "episodes_per_policy": 5,
            "sigma": 0.02,
            "biases": "glorot_normal",
            "rank_ties": "index",
            "common_random_numbers": "off",
            "statistics_fraction": 0.01,
            "noise_table_size": 250_000_000,
        },
        # The authors' pre-training of a primitive.
        per_environment={f"{body}-flagrun": {"population_size": 256} for body in ("ant", "point")},
    ),
    "laptop": Preset(per_environment={"point-gather": {"learning_rate": 0.04}}),
    "smoke": Preset(values={"population_size": 16, "noise_table_size": 1_000_000}),
}
"""Values of one policy without goals."""

# With these an ant learns to walk, and to gather, in minutes; see docs/learning.md.
_ANT_WALKER: dict[str, Any] = {
    "primitive_view": "egocentric",
    "symmetry": "dihedral",
    "goal_encoding": "angle_metres",
    "clock_frequency": 0.8,
    "primitive_estimate": "interval",
    "fall_price": 8.0,
    "output_weights": "zero",
    "weight_decay": 0.0,
    "horizon": 500,
}
_ANT: dict[str, Any] = {
    **_ANT_WALKER,
    "intervals": 3,
    "primitive_hidden": (64, 64),
    "controller_interval": 10,
    "minimum_goal_distance": False,
    "population_size": 200,
    "sigma": 0.1,
    "learning_rate": 0.05,
    "primitive_population_size": 1200,
    "primitive_sigma": 0.05,
    "primitive_learning_rate": 0.015,
}
# Few controllers: in as many steps they have more updates.
_ANT_TO_FOOD = {
    **_ANT,
    "hidden": (8,),
    "controller_network": "equivariant",
    "controller_view": "sectors",
    "controller_output": "heading_direction",
    "population_size": 40,
    "sigma": 0.05,
    "learning_rate": 0.02,
    "generations": 120,
}
_ANT_TO_TARGET = {
    **_ANT,
    "hidden": (32,),
    "controller_view": "position",
    "controller_output": "direction",
    "max_tilt": 60.0,
    "explore": "archive",
    "explore_horizon": 1500,  # a slow walker finds the way, and a faster one a shorter way
    "population_size": 40,
    "generations": 200,
}
_TARGETS: Mapping[str, Mapping[str, Any]] = {
    "maze": {"target": (0.0, 16.0)},  # that of evaluation: a search needs one target
    "push": {},
    "fall": {"explore_horizon": 2500},
}
"""Values of each task with a target."""

SHES_PRESETS: Mapping[str, Preset] = {
    **SES_PRESETS,
    "laptop": Preset(
        per_environment={
            "ant-flagrun": {
                **_ANT_WALKER,
                "intervals": 1,
                "hidden": (),
                "population_size": 1200,
                "sigma": 0.05,
                "learning_rate": 0.02,
                "generations": 30,
                "evaluation_interval": 5,
            },
            "ant-gather": _ANT_TO_FOOD,
            **{f"ant-{task}": {**_ANT_TO_TARGET, **own} for task, own in _TARGETS.items()},
            "point-gather": {"controller_interval": 10, "learning_rate": 0.04},
            "robotics-point-maze": {"minimum_goal_distance": False},
        }
    ),
}
"""Values of a controller and its primitive, and of a primitive alone."""
