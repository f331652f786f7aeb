"""Settings of the evolution strategies: one class a room, and which rooms each algorithm has.

Source: tables and sections are those of the SHES paper.

Deviation: the defaults are the preset `laptop`, not Table I of the paper; the docstrings name its values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from shes.envs.bodies.symmetry import SYMMETRIES
from shes.es.mirror import MIRRORINGS
from shes.es.novelty import NOVELTY_RULES
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS
from shes.es.ranking import TIES
from shes.es.schedules import SCHEDULES
from shes.es.shaping import FITNESS_SHAPINGS
from shes.hierarchy.goals import GOAL_ENCODINGS
from shes.hierarchy.outputs import CONTROLLER_OUTPUTS
from shes.hierarchy.population import COMMON_RANDOM_NUMBERS
from shes.hierarchy.rewards import PRIMITIVE_REWARDS
from shes.policies.mlp import BIAS_INITIALISATIONS, OUTPUT_INITIALISATIONS
from shes.settings import Choices, Example, Ge, Gt, Le, Lt, Needs, Settings, Shown

__all__ = [
    "PRIMITIVE_ROOMS",
    "SCHEDULED",
    "SES_ROOMS",
    "SHES_ROOMS",
    "EstimateSettings",
    "EvolutionSettings",
    "HierarchySettings",
    "NetworkSettings",
    "NoveltySettings",
    "PrimitiveEstimateSettings",
    "PrimitiveSettings",
    "PrimitiveTransferSettings",
    "ScheduleSettings",
    "TransferSettings",
]

SCHEDULED = {
    "learning_rate": ("learning_rate_schedule", "learning_rate_end"),
    "sigma": ("sigma_schedule", "sigma_end"),
    "episodes_per_policy": ("episodes_schedule", "episodes_end"),
}
"""Settings with a schedule: the setting of its kind and that of its end."""
_CHANGING = tuple(name for name in SCHEDULES if name != "constant")
_OWN = "Register your own first: shes.register_{}, or --import MODULE."


@dataclass(frozen=True, kw_only=True)
class EvolutionSettings(Settings):
    """Population and update."""

    population_size: Annotated[int, Ge(1), Shown(everyday=True)] = 240
    """Policies in a generation, mirrored ones included (Table I: 1000)."""
    episodes_per_policy: Annotated[int, Ge(1)] = 1
    """Episodes that a policy's fitness is the mean of (Table I: 5)."""
    sigma: Annotated[float, Gt(0), Shown(everyday=True)] = 0.07
    """Standard deviation of the perturbations (Table I: 0.02)."""
    learning_rate: Annotated[float, Gt(0), Shown(everyday=True)] = 0.01
    """Learning rate (Table I, for Adam: 0.01); with clipup the length of a step, at most twice that."""
    weight_decay: Annotated[float, Ge(0)] = 0.005
    """Coefficient of the parameters subtracted from the gradient estimate (authors' code: 0.005)."""
    weight_decay_form: Literal["gradient", "decoupled"] = "gradient"
    """Where the decay enters: gradient (before the optimizer, as the authors' code), or decoupled (AdamW)."""
    mirrored: Annotated[str, Choices(MIRRORINGS)] = "quad"
    """How the members of a group mirror its noise: quad (four-way), pair (two-way) or none (section II-F)."""
    fitness_shaping: Annotated[str, Choices(FITNESS_SHAPINGS)] = "centred_rank"
    """How fitness becomes weights: centred_rank, pair_rank (differences of mirrored pairs), z_score, top_fraction."""
    hold_tied: bool = True
    """Whether a level stays as it is where all its members are worth the same (the paper's method: no)."""
    rank_ties: Annotated[
        str,
        Choices(TIES),
        Needs("fitness_shaping", ("centred_rank", "top_fraction")),
        Needs("primitive_fitness_shaping", ("centred_rank", "top_fraction")),
    ] = "average"
    """How equal fitnesses rank: average or index."""
    top_fraction: Annotated[
        float,
        Gt(0),
        Lt(1),
        Needs("fitness_shaping", ("top_fraction",)),
        Needs("primitive_fitness_shaping", ("top_fraction",)),
    ] = 0.2
    """Share of the population that counts with top_fraction."""
    optimizer: Annotated[str, Choices(OPTIMIZERS)] = "adam"
    """How a gradient becomes a step: adam, sgd (with momentum) or clipup."""
    momentum: Annotated[float, Ge(0), Lt(1), Needs("optimizer", ("sgd", "clipup"))] = 0.9
    """Momentum of sgd and clipup."""
    common_random_numbers: Annotated[str, Choices(COMMON_RANDOM_NUMBERS)] = "group"
    """Who shares the episodes' seeds: off (nobody), the members of a mirrored group, or the whole population."""
    statistics_fraction: Annotated[float, Ge(0), Le(1)] = 1.0
    """Share of the groups whose observations enter the observation statistics."""
    noise_table_size: Annotated[int, Ge(2)] = 25_000_000
    """Normals in the shared noise table, 4 bytes each (authors' code: 250 million)."""


@dataclass(frozen=True, kw_only=True)
class ScheduleSettings(Settings):
    """Schedules."""

    learning_rate_schedule: Annotated[str, Choices(SCHEDULES)] = "constant"
    """How the learning rate goes to its end: constant, linear, exponential or cosine."""
    learning_rate_end: Annotated[float, Ge(0)] | None = None
    """Learning rate at the end of its schedule."""
    sigma_schedule: Annotated[str, Choices(SCHEDULES)] = "constant"
    """How sigma goes to its end: constant, linear, exponential or cosine."""
    sigma_end: Annotated[float, Gt(0)] | None = None
    """Standard deviation of the perturbations at the end of its schedule."""
    episodes_schedule: Annotated[str, Choices(SCHEDULES)] = "constant"
    """How the episodes of a policy go to their end, rounded: constant, linear, exponential or cosine."""
    episodes_end: Annotated[int, Ge(1)] | None = None
    """Episodes of a policy at the end of their schedule."""
    schedule_generations: Annotated[
        int,
        Ge(1),
        Needs("learning_rate_schedule", _CHANGING),
        Needs("sigma_schedule", _CHANGING),
        Needs("episodes_schedule", _CHANGING),
    ] = 1000
    """Generations from the start of every schedule to its end."""


@dataclass(frozen=True, kw_only=True)
class NoveltySettings(Settings):
    """Novelty."""

    novelty: Annotated[str, Choices(("none", *NOVELTY_RULES))] = "none"
    """Novelty in the fitness: none, ns, nsr, nsra (Conti et al. 2018), nsra_reset (authors' code)."""
    novelty_neighbours: Annotated[int, Ge(1), Needs("novelty", tuple(NOVELTY_RULES))] = 10
    """Nearest final positions that novelty is measured from (k)."""


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(Settings):
    """Networks."""

    hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64"), Shown(everyday=True)] = (32,)
    """Hidden layers of the policies (paper: 256 256 256); no number makes them linear."""
    biases: Annotated[str, Choices(BIAS_INITIALISATIONS)] = "zero"
    """How biases start: zero or glorot_normal."""
    output_weights: Annotated[str, Choices(OUTPUT_INITIALISATIONS)] = "glorot_normal"
    """How the output layer starts: glorot_normal, or zero (a policy that does nothing yet)."""
    clock_frequency: Annotated[float, Gt(0)] | None = None
    """Frequency, in Hz, of a clock that the primitive (with es: the policy) observes; no clock if none."""


@dataclass(frozen=True, kw_only=True)
class PrimitiveSettings(Settings):
    """Goals, and the primitive that reaches them."""

    controller_interval: Annotated[int, Ge(1), Shown(everyday=True)] = 25
    """Steps that a goal is held (c in Table I: 25)."""
    goal_distance: Annotated[float, Gt(0)] = 4.0
    """Metres that a controller's output of 1 stands for (Table I)."""
    goal_encoding: Annotated[str, Choices(GOAL_ENCODINGS, _OWN.format("goal_encoding"))] = "angle"
    """What the primitive is told about its goal (section II-C): angle, unit_vector, vector or angle_metres."""
    primitive_reward: Annotated[str, Choices(PRIMITIVE_REWARDS, _OWN.format("primitive_reward"))] = "progress"
    """What the primitive is paid (section II-B): progress (equation 1), metres, negative_distance or cosine."""
    primitive_view: Literal["observation", "proprioception", "egocentric"] = "observation"
    """What the primitive sees beside its goal: the observation, proprioception (the robot's coordinates), or egocentric
    (the robot in its own frame, without its place)."""
    symmetry: Annotated[str, Choices(SYMMETRIES), Needs("primitive_view", ("egocentric",))] = "none"
    """The body's symmetry that turns every goal to the front, for an egocentric view: none, rotation or dihedral."""
    hide_position: bool = False
    """Whether the robot's absolute x and y are hidden from the primitive (as in Gymnasium's Ant by default)."""


@dataclass(frozen=True, kw_only=True)
class HierarchySettings(PrimitiveSettings):
    """Controller and primitive."""

    minimum_goal_distance: bool = True
    """Whether goals nearer than 1 m are pushed outward."""
    controller_output: Annotated[str, Choices(CONTROLLER_OUTPUTS, _OWN.format("controller_output"))] = "vector"
    """What the controller's outputs say: vector (to the goal), heading_vector (that, ahead and left of the robot), or
    one_hot (a direction of eight, a distance)."""
    controller_view: Literal["observation", "egocentric"] = "observation"
    """What the controller sees: the observation, or egocentric (the robot in its own frame, then the rest)."""
    controller_weight_decay: Annotated[float, Ge(0)] | None = None
    """weight_decay of the controller, which a sparse reward leaves to the decay alone; as for the primitive if none."""
    perturbation: Annotated[str, Choices(PERTURBATIONS)] = "many_to_many"
    """What a generation perturbs (section II-E): both levels, one_to_many: in turns, one_to_many_halves: half each."""
    primitive_hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64")] | None = None
    """Hidden layers of the primitive; the same as the controller's if none."""


_BY_INTERVAL = Needs("primitive_estimate", ("interval",))


@dataclass(frozen=True, kw_only=True)
class PrimitiveEstimateSettings(Settings):
    """How the primitive is judged."""

    primitive_estimate: Literal["episode", "interval"] = "episode"
    """How the primitive is judged: by whole episodes, or by interval (pairs that branch off the same state)."""
    primitive_fitness_shaping: Annotated[str, Choices(FITNESS_SHAPINGS), _BY_INTERVAL] = "pair_rank"
    """What a primitive's fitness counts that is judged by intervals: as fitness_shaping."""
    intervals: Annotated[int, Ge(1), _BY_INTERVAL] = 2
    """Intervals of a goal that a branch plays."""
    fall_price: Annotated[float, Ge(0)] = 0.0
    """What a fall takes off a primitive's shaped fitness; the best pair's is worth 1."""


@dataclass(frozen=True, kw_only=True)
class EstimateSettings(PrimitiveEstimateSettings):
    """How the primitive is judged beside a controller."""

    primitive_population_size: Annotated[int, Ge(2), _BY_INTERVAL] | None = None
    """Policies in the branches of a generation beside a controller; the same as population_size if none."""
    primitive_sigma: Annotated[float, Gt(0), _BY_INTERVAL] | None = None
    """Standard deviation of the perturbations in branches beside a controller; sigma, with its schedule, if none."""
    primitive_learning_rate: Annotated[float, Gt(0), _BY_INTERVAL] | None = None
    """Learning rate of a primitive in branches beside a controller; learning_rate, with its schedule, if none."""


@dataclass(frozen=True, kw_only=True)
class PrimitiveTransferSettings(Settings):
    """Transfer of a primitive (section II-D)."""

    primitive: Annotated[str, Example("ant-walker"), Shown(everyday=True)] | None = None
    """Run or shipped agent whose primitive this one begins with (section II-D): parameters, observation statistics."""
    primitive_checkpoint: Annotated[str, Needs("primitive")] = "best"
    """Which checkpoint of that run: best, last or the number of a generation."""
    freeze_primitive: Annotated[bool, Needs("primitive")] = True
    """Whether that primitive stays as it is, or learns on."""


@dataclass(frozen=True, kw_only=True)
class TransferSettings(PrimitiveTransferSettings):
    """Transfer (section II-D)."""

    controller: Annotated[str, Example("runs/walk")] | None = None
    """Run or shipped agent whose controller this one begins with: parameters, observation statistics. It learns on."""
    controller_checkpoint: Annotated[str, Needs("controller")] = "best"
    """Which checkpoint of that run: best, last or the number of a generation."""


_EVERY: Mapping[str, type[Settings]] = {"evolution": EvolutionSettings, "schedules": ScheduleSettings}
SHES_ROOMS: Mapping[str, type[Settings]] = {
    **_EVERY,
    "novelty": NoveltySettings,
    "networks": NetworkSettings,
    "hierarchy": HierarchySettings,
    "estimate": EstimateSettings,
    "transfer": TransferSettings,
}
"""Settings of a controller and its primitive."""
PRIMITIVE_ROOMS: Mapping[str, type[Settings]] = {
    **_EVERY,
    "networks": NetworkSettings,
    "hierarchy": PrimitiveSettings,
    "estimate": PrimitiveEstimateSettings,
    "transfer": PrimitiveTransferSettings,
}
"""Settings of a primitive alone."""
SES_ROOMS: Mapping[str, type[Settings]] = {**_EVERY, "novelty": NoveltySettings, "networks": NetworkSettings}
"""Settings of one policy without goals."""
