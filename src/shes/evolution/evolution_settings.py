"""Settings of the evolution strategies, the sections of each algorithm, and their values in presets.

Options of an optimizer, a reward or another registered class are defined in that class: see `shes.options`.

Source: SHES paper (tables and sections); docs/differences.md; docs/learning.md.
Deviation: the defaults are those of the preset `laptop`. The docstrings give the values of Table I of the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from shes.agents.goals import CONTROLLER_OUTPUTS, GOAL_ENCODINGS
from shes.agents.rewards import PRIMITIVE_REWARDS
from shes.agents.views import CONTROLLER_VIEWS, PRIMITIVE_VIEWS
from shes.algorithms.contract import Preset
from shes.es.perturbation import PERTURBATIONS
from shes.evolution.estimates import EvolutionSettings
from shes.settings import Choices, Example, Ge, Gt, Needs, Settings, Shown


@dataclass(frozen=True, kw_only=True)
class ExplorationSettings(Settings):
    """Exploration."""

    explore: Literal["none", "archive"] = "none"
    """Search for a path to the target: none, or an archive of places to which a simulation goes back. Progress along
    the path found is then the reward of training, and about half of its episodes begin on the path."""
    explore_horizon: Annotated[int, Ge(1), Needs("explore", ("archive",))] | None = None
    """Longest path of the search in control steps; none for the horizon."""


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(Settings):
    """Networks."""

    hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64"), Shown(everyday=True)] = (32,)
    """Sizes of the hidden layers (paper: 256 256 256); without a number the policies are linear."""
    biases: Literal["zero", "glorot_normal"] = "zero"
    """Initialisation of the biases."""
    output_weights: Literal["glorot_normal", "zero"] = "glorot_normal"
    """Initialisation of the output layer; with zero the initial outputs are zero."""
    clock_frequency: Annotated[float, Gt(0)] | None = None
    """Frequency in Hz of a clock that the primitive (with es: the policy) observes; none for no clock."""


@dataclass(frozen=True, kw_only=True)
class PrimitiveSettings(Settings):
    """Goals, and the primitive that reaches them."""

    controller_interval: Annotated[int, Ge(1)] = 25
    """Control steps for which a goal is held (c in Table I: 25)."""
    goal_distance: Annotated[float, Gt(0)] = 4.0
    """Goal distance in metres for a controller output of 1 (Table I: 4)."""
    goal_encoding: Annotated[str, Choices(GOAL_ENCODINGS)] = "angle"
    """Goal features that the primitive observes (section II-C)."""
    primitive_reward: Annotated[str, Choices(PRIMITIVE_REWARDS)] = "progress"
    """Intrinsic reward of the primitive (section II-B)."""
    primitive_view: Annotated[str, Choices(PRIMITIVE_VIEWS)] = "observation"
    """Values that the primitive observes in addition to its goal."""
    symmetry: Annotated[Literal["none", "rotation", "dihedral", "auto"], Needs("primitive_view", ("egocentric",))] = (
        "none"
    )
    """Symmetry of the body by which every goal is turned to the front, for an egocentric view; auto is what it has."""


@dataclass(frozen=True, kw_only=True)
class HierarchySettings(PrimitiveSettings):
    """Controller and primitive."""

    minimum_goal_distance: bool = True
    """Whether goals nearer than 1 m are moved outward."""
    controller_output: Annotated[str, Choices(CONTROLLER_OUTPUTS)] = "vector"
    """Meaning of the controller's outputs."""
    controller_network: Literal["mlp", "equivariant"] = "mlp"
    """Network of the controller: mlp, or equivariant (turned and mirrored sectors give turned and mirrored goals, and
    hidden counts the units per sector)."""
    controller_view: Annotated[str, Choices(CONTROLLER_VIEWS)] = "observation"
    """Values that the controller observes."""
    perturbation: Annotated[str, Choices(PERTURBATIONS)] = "many_to_many"
    """Which levels a generation perturbs (section II-E)."""
    primitive_hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64")] | None = None
    """Sizes of the primitive's hidden layers; none for those of the controller."""


_BY_INTERVAL = Needs("primitive_estimate", ("interval",))


@dataclass(frozen=True, kw_only=True)
class PrimitiveEstimateSettings(Settings):
    """Evaluation of the primitive."""

    primitive_estimate: Literal["episode", "interval"] = "episode"
    """How the primitive is evaluated: by whole episodes, or by intervals (pairs that branch off the same state)."""
    intervals: Annotated[int, Ge(1), _BY_INTERVAL] = 2
    """Goals that a branch pursues, each for a controller interval."""
    fall_price: Annotated[float, Ge(0)] = 0.0
    """Subtracted from a primitive's shaped fitness for a fall, in part for tilt; the best pair has the weight 1."""


@dataclass(frozen=True, kw_only=True)
class EstimateSettings(PrimitiveEstimateSettings):
    """Evaluation of the primitive under a controller."""

    practice: Annotated[int, Ge(0), _BY_INTERVAL] = 0
    """First generations, in which the primitive alone learns, on goals that wander. Search and schedules follow."""
    primitive_population_size: Annotated[int, Ge(2), _BY_INTERVAL] | None = None
    """Policies in the branches of a generation; none for population_size."""
    primitive_sigma: Annotated[float, Gt(0), _BY_INTERVAL] | None = None
    """Standard deviation of the perturbations in branches; none for sigma with its schedule."""
    primitive_learning_rate: Annotated[float, Gt(0), _BY_INTERVAL] | None = None
    """Learning rate of a primitive in branches; none for learning_rate with its schedule."""


@dataclass(frozen=True, kw_only=True)
class PrimitiveTransferSettings(Settings):
    """Transfer of a primitive (section II-D)."""

    primitive: Annotated[str, Example("ant-walker"), Shown(everyday=True)] | None = None
    """Run or shipped agent whose primitive is transferred (II-D): its best checkpoint, or RUN@last, RUN@60."""
    freeze_primitive: Annotated[bool, Needs("primitive")] = True
    """Whether that primitive is frozen; otherwise it continues to learn."""


@dataclass(frozen=True, kw_only=True)
class TransferSettings(PrimitiveTransferSettings):
    """Transfer (section II-D)."""

    controller: Annotated[str, Example("runs/walk")] | None = None
    """Run or shipped agent whose controller is transferred, as --primitive RUN is. It keeps learning."""


SHES_SECTIONS: Mapping[str, type[Settings]] = {
    "evolution": EvolutionSettings,
    "exploration": ExplorationSettings,
    "networks": NetworkSettings,
    "hierarchy": HierarchySettings,
    "estimate": EstimateSettings,
    "transfer": TransferSettings,
}
"""Settings of a controller and its primitive."""
SES_SECTIONS: Mapping[str, type[Settings]] = {"evolution": EvolutionSettings, "networks": NetworkSettings}
"""Settings of one policy without goals."""
PRIMITIVE_SECTIONS: Mapping[str, type[Settings]] = {
    **SES_SECTIONS,
    "hierarchy": PrimitiveSettings,
    "estimate": PrimitiveEstimateSettings,
    "transfer": PrimitiveTransferSettings,
}
"""Settings of a primitive alone."""

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
            "fitness_shaping": "centred_rank_index",
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

_BRANCHES: dict[str, Any] = {
    "primitive_view": "egocentric",
    "goal_encoding": "angle_metres",
    "primitive_estimate": "interval",
    "output_weights": "zero",
    "weight_decay": 0.0,
    "horizon": 500,
}
# With these an ant learns to walk, and to gather, in minutes; see docs/learning.md.
_ANT_WALKER = {**_BRANCHES, "symmetry": "dihedral", "clock_frequency": 0.8, "fall_price": 8.0}
_ANT: dict[str, Any] = {
    **_ANT_WALKER,
    "intervals": 3,
    "primitive_hidden": (),
    "controller_interval": 10,
    "minimum_goal_distance": False,
    "population_size": 40,  # in as many steps, few controllers have more updates
    "sigma": 0.1,
    "learning_rate": 0.05,
    "primitive_population_size": 1200,
    "primitive_sigma": 0.05,
    "primitive_learning_rate": 0.015,
}
_ANT_TO_FOOD = {
    **_ANT,
    "hidden": (8,),
    "controller_network": "equivariant",
    "controller_view": "sectors",
    "controller_output": "heading_direction",
    "sigma": 0.05,
    "learning_rate": 0.02,
    "generations": 120,
}
_TO_TARGET = {"hidden": (32,), "controller_view": "position", "controller_output": "direction", "explore": "archive"}
_ANT_TO_TARGET = {
    **_ANT,
    **_TO_TARGET,
    "max_tilt": 60.0,
    "explore_horizon": 1500,  # a slow walker finds the way, and a faster one a shorter way
    "fitness_shaping": "pair_rank",
    "learning_rate": 0.02,
    "learning_rate_end": 0.005,  # of the controller; the primitive goes on to walk faster
    "primitive_reward": "metres",
    "fall_price": 4.0,
    "evaluation_episodes": 200,  # with 50, the best of the last evaluations is the luckiest
}
_ANT_TO_TARGET |= {"practice": 60, "schedule_generations": 70, "generations": 130}
# A higher rate: falls. Goals of 10 steps, or less practice: a late path. A higher price: worse in the end.
_TO_BLOCK = {**_ANT_TO_TARGET, "learning_rate": 0.015, "controller_interval": 25, "intervals": 1, "practice": 80}
_TO_BLOCK |= {"schedule_generations": 220, "generations": 300, "evaluation_interval": 20}
_TO_BLOCK |= {"fall_price": 2.0, "primitive_learning_rate": None}  # its rate falls, too
_POINT_TO_TARGET = {
    **_BRANCHES,
    **_TO_TARGET,
    "symmetry": "auto",
    "controller_interval": 10,
    "fitness_shaping": "pair_rank",  # the members of a pair begin at the same place of the path
    "population_size": 80,
    "sigma": 0.1,
    "learning_rate": 0.05,
    "primitive_population_size": 400,
    "generations": 60,
}

# For a robot from a file, with control steps of 0.02 s: a goal lasts a second. See docs/robots.md.
_ROBOT_WALKER: dict[str, Any] = {
    **_ANT_WALKER,
    "symmetry": "auto",
    "clock_frequency": 2.0,
    "primitive_reward": "metres",
    "horizon": 1000,
    "evaluation_horizon": 1000,
    "controller_interval": 50,
    "goal_distance": 8.0,
}
_ROBOT = {**_ANT, **_ROBOT_WALKER, "controller_interval": 25}
_ROBOT_TO_TARGET = {**_ROBOT, **_TO_TARGET, "explore_horizon": 4000, "max_tilt": 60.0, "generations": 200}
_ROBOT_TO_TARGET |= {"horizon": 2000, "evaluation_horizon": 2000, "practice": 80, "population_size": 200}

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
            "ant-maze": {**_ANT_TO_TARGET, "target": (0.0, 16.0)},  # that of evaluation: a search needs one target
            "ant-push": _TO_BLOCK,
            "ant-fall": {**_TO_BLOCK, "explore_horizon": 2500},
            "flagrun": {
                **_ROBOT_WALKER,
                "hidden": (),
                "population_size": 600,
                "sigma": 0.05,
                "learning_rate": 0.02,
                "generations": 200,
            },
            "gather": {**_ANT_TO_FOOD, **_ROBOT, "hidden": (8,), "goal_distance": 4.0},
            "maze": {**_ROBOT_TO_TARGET, "target": (0.0, 16.0)},
            **dict.fromkeys(("push", "fall"), _ROBOT_TO_TARGET),
            "point-gather": {"controller_interval": 10, "learning_rate": 0.04},
            "point-maze": {**_POINT_TO_TARGET, "target": (0.0, 16.0)},
            "point-push": _POINT_TO_TARGET,
            "point-fall": {**_POINT_TO_TARGET, "generations": 100},
            "robotics-point-maze": {"minimum_goal_distance": False},
        }
    ),
}
"""Values of a controller and its primitive, and of a primitive alone."""
