"""Every setting of a training run. It stops here: the rooms below take plain arguments."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from shes.envs.registry import find_environment
from shes.errors import ConfigError
from shes.es.mirror import sign_matrix
from shes.es.perturbation import check_perturbation
from shes.es.schedules import make_schedule
from shes.runs.settings import NAMES, SCHEDULED, check_value, flag, out_of_range

__all__ = ["EXECUTION_FIELDS", "HEADINGS", "WITHOUT_FLAG", "TrainConfig", "check_fields", "in_words_of_today"]

EXECUTION_FIELDS = frozenset(
    {
        "preset",
        "backend",
        "num_workers",
        "chunk_size",
        "device",
        "nconmax",
        "njmax",
        "generations",
        "env_steps",
        "minutes",
        "keep_checkpoints",
    }
)
"""Settings that say how, where and how long, and never change what a run is.

None changes a number of a generation but the device, which rounds otherwise: a run's record says where it changed.
"""

WITHOUT_FLAG = frozenset({"env"})
"""Settings that `shes train` takes as its first word."""

HEADINGS: dict[str, str] = {
    "env": "run",
    "backend": "workers",
    "population_size": "population and update",
    "learning_rate_schedule": "schedules",
    "novelty": "novelty",
    "hidden": "networks",
    "controller_interval": "hierarchy",
    "primitive_estimate": "estimate of the primitive",
    "primitive": "transfer",
    "horizon": "episodes and environment",
    "evaluation_interval": "evaluation, checkpoints, memory",
}
"""Where the sections of `TrainConfig` begin, and what the help of `shes train` calls them."""

_FORMER = {"True": {"common_random_numbers": "group"}, "False": {"common_random_numbers": "off"}}
"""What runs of version 0.1 called otherwise: they stay readable."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of a training run. Table and sections are those of the SHES paper."""

    # Deviation: the defaults are the preset `laptop`, not the paper's Table I; the docstrings name its values.

    env: str
    """Environment; `shes envs` lists them. Or `gymnasium:` and an id of Gymnasium."""
    algorithm: str = "shes"
    """shes: controller and primitive (on flagrun the primitive alone); es: one policy without goals, S-ES."""
    preset: str = "laptop"
    """What the other settings start from: paper, laptop or smoke."""
    seed: int = 1
    """Seed of every random draw."""
    generations: int = 1000
    """Generations after which the run ends (Table I: 3000)."""
    env_steps: int | None = None
    """Environment steps of training after whose generation the run ends, whichever comes first."""
    minutes: float | None = None
    """Minutes after which this call ends, whichever comes first."""

    backend: str = "processes"
    """Where the work is done on the CPU: processes (on this machine) or serial (in this process)."""
    num_workers: int = 0
    """Worker processes; 0 is one for every core. Never changes a number."""
    chunk_size: int = 0
    """Policies that a worker, or a device, runs in lockstep; 0 chooses. Never changes a number on the CPU."""
    device: str = "cpu"
    """What computes the physics: cpu, cuda (an NVIDIA card; extra gpu) or warp-cpu (extra warp; for tests)."""
    nconmax: int | None = None
    """Contacts that a device has room for, per simulation on average; chosen by the world if none."""
    njmax: int | None = None
    """Constraint rows that a device has room for, per simulation; chosen by the world if none."""

    population_size: int = 240
    """Policies in a generation, mirrored ones included (Table I: 1000)."""
    episodes_per_policy: int = 1
    """Episodes that a policy's fitness is the mean of (Table I: 5)."""
    sigma: float = 0.07
    """Standard deviation of the perturbations (Table I: 0.02)."""
    learning_rate: float = 0.01
    """Learning rate (Table I, for Adam: 0.01); with clipup the length of a step, at most twice that."""
    weight_decay: float = 0.005
    """Coefficient of the parameters subtracted from the gradient estimate (authors' code: 0.005)."""
    weight_decay_form: str = "gradient"
    """Where the decay enters: gradient (before the optimizer, as the authors' code), or decoupled (AdamW)."""
    controller_weight_decay: float | None = None
    """The same for the controller, which a sparse reward leaves to the decay alone; as for the primitive if none."""
    mirrored: str = "quad"
    """How the members of a group mirror its noise: quad (four-way), pair (two-way) or none (section II-F)."""
    perturbation: str = "many_to_many"
    """What a generation perturbs (section II-E): both levels, one_to_many: in turns, one_to_many_halves: half each."""
    fitness_shaping: str = "centred_rank"
    """What a fitness counts: centred_rank, pair_rank (the differences within mirrored pairs), z_score, top_fraction."""
    hold_tied: bool = True
    """Whether a level stays as it is where all its members are worth the same (the paper's method: no)."""
    rank_ties: str = "average"
    """How equal fitnesses rank: average or index."""
    top_fraction: float = 0.2
    """Share of the population that counts with top_fraction."""
    optimizer: str = "adam"
    """How a gradient becomes a step: adam, sgd (with momentum) or clipup."""
    momentum: float = 0.9
    """Momentum of sgd and clipup."""
    common_random_numbers: str = "group"
    """Who shares the episodes' seeds: off (nobody), the members of a mirrored group, or the whole population."""
    statistics_fraction: float = 1.0
    """Share of the groups whose observations enter the observation statistics."""

    learning_rate_schedule: str = "constant"
    """How the learning rate goes to its end: constant, linear, exponential or cosine."""
    learning_rate_end: float | None = None
    """Learning rate at the end of its schedule."""
    sigma_schedule: str = "constant"
    """How sigma goes to its end: constant, linear, exponential or cosine."""
    sigma_end: float | None = None
    """Standard deviation of the perturbations at the end of its schedule."""
    episodes_schedule: str = "constant"
    """How the episodes of a policy go to their end, rounded: constant, linear, exponential or cosine."""
    episodes_end: int | None = None
    """Episodes of a policy at the end of their schedule."""
    schedule_generations: int = 1000
    """Generations from the start of every schedule to its end."""

    novelty: str = "none"
    """Novelty in the controller's fitness: none, ns, nsr, nsra (Conti et al. 2018) or nsra_reset (authors' code)."""
    novelty_neighbours: int = 10
    """Nearest final positions that novelty is measured from (k)."""

    hidden: tuple[int, ...] = (32,)
    """Hidden layers of both policies (paper: 256 256 256); no number makes them linear."""
    primitive_hidden: tuple[int, ...] | None = None
    """Hidden layers of the primitive; the same as the controller's if none."""
    biases: str = "zero"
    """How biases start: zero or glorot_normal."""
    output_weights: str = "glorot_normal"
    """How the output layer starts: glorot_normal, or zero (a policy that does nothing yet)."""
    controller_interval: int = 25
    """Steps that a goal is held (c in Table I: 25)."""
    goal_distance: float = 4.0
    """Metres that a controller's output of 1 stands for (Table I)."""
    minimum_goal_distance: bool = True
    """Whether goals nearer than 1 m are pushed outward."""
    controller_output: str = "vector"
    """What the controller's outputs say: vector (to the goal), heading_vector (that, ahead and left of the robot), or
    one_hot (a direction of eight, a distance)."""
    controller_view: str = "observation"
    """What the controller sees: the observation, or egocentric (the robot in its own frame, then the rest)."""
    goal_encoding: str = "angle"
    """What the primitive is told about its goal (section II-C): angle, unit_vector, vector or angle_metres."""
    primitive_reward: str = "progress"
    """What the primitive is paid (section II-B): progress (equation 1), metres, negative_distance or cosine."""
    primitive_view: str = "observation"
    """What the primitive sees beside its goal: the observation, proprioception (the robot's coordinates), or egocentric
    (the robot in its own frame, without its place)."""
    symmetry: str = "none"
    """The body's symmetry that turns every goal to the front, for an egocentric view: none, rotation or dihedral."""
    hide_position: bool = False
    """Whether the robot's absolute x and y are hidden from the primitive (as in Gymnasium's Ant by default)."""
    clock_frequency: float | None = None
    """Frequency, in Hz, of a clock that the primitive (with es: the policy) observes; no clock if none."""

    primitive_estimate: str = "episode"
    """How the primitive is judged: by whole episodes, or by interval (pairs that branch off the same state)."""
    primitive_fitness_shaping: str = "pair_rank"
    """What a primitive's fitness counts that is judged by intervals: as fitness_shaping."""
    intervals: int = 2
    """Intervals of a goal that a branch plays."""
    fall_price: float = 0.0
    """What a fall takes off a primitive's shaped fitness; the best pair's is worth 1."""
    primitive_population_size: int | None = None
    """Policies in the branches of a generation beside a controller; the same as population_size if none."""
    primitive_sigma: float | None = None
    """Standard deviation of the perturbations in branches beside a controller; sigma, with its schedule, if none."""
    primitive_learning_rate: float | None = None
    """Learning rate of a primitive in branches beside a controller; learning_rate, with its schedule, if none."""

    primitive: str | None = None
    """Run or shipped agent whose primitive this one begins with (section II-D): parameters, observation statistics."""
    primitive_checkpoint: str = "best"
    """Which checkpoint of that run: best, last or the number of a generation."""
    freeze_primitive: bool = True
    """Whether that primitive stays as it is, or learns on."""
    controller: str | None = None
    """Run or shipped agent whose controller this one begins with: parameters, observation statistics. It learns on."""
    controller_checkpoint: str = "best"
    """Which checkpoint of that run: best, last or the number of a generation."""

    horizon: int = 200
    """Control steps in an episode of training (Table I: 500)."""
    evaluation_horizon: int | None = None
    """Control steps in an episode of evaluation; the same as in training if none."""
    spec: str = "shes"
    """Published specification of the environment: shes, or hiro (Nachum et al. 2018, rllab)."""
    integrator: str = "default"
    """MuJoCo's integrator; default is that of the specification: euler for shes, rk4 for hiro."""
    reset_noise: float = 0.1
    """Noise on the robot's pose and velocity at a reset, in training."""
    evaluation_reset_noise: float = 0.1
    """The same in evaluation."""
    target_sampling: str = "square"
    """Maze: training's targets are uniform in a square that covers walls too, or there in free_cells only."""
    target: tuple[float, ...] | None = None
    """Maze, push, fall: a fixed target of training, in metres, in place of the task's own."""
    evaluation_target: tuple[float, ...] | None = None
    """Maze, push, fall: the target of evaluation, in metres, in place of the task's own."""
    observe_block: bool | None = None
    """Push, fall: whether the block is observed; none leaves it to the specification (shes: yes, hiro: no)."""
    fall_penalty: bool = True
    """Gather, hiro: whether the step of a fall pays -10 in place of its pickups."""
    evaluation_interval: int = 10
    """Generations between evaluations of the mean policies (there is one after the first generation, too)."""
    evaluation_episodes: int = 50
    """Episodes of an evaluation."""
    keep_checkpoints: int = 50
    """Generations between checkpoints that are kept beside `last` and `best`."""
    noise_table_size: int = 25_000_000
    """Normals in the shared noise table, 4 bytes each (authors' code: 250 million)."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: A value is out of range.
            UnknownNameError: A name is in no registry.
        """
        for field in fields(self):
            object.__setattr__(self, field.name, _plain(getattr(self, field.name)))
        for name in ("env", *NAMES):
            if not isinstance(getattr(self, name), str):
                raise out_of_range(name, getattr(self, name), "a name")
        environment = find_environment(self.env)
        for name in (field.name for field in fields(self)):
            check_value(name, getattr(self, name))
        if environment.has_own_physics and self.device != "cpu":
            raise ConfigError(
                f"device is {self.device!r}, but {self.env} has physics of its own: it runs on the CPU alone. "
                "Set --device cpu."
            )
        if self.seed >= 2**63:
            raise out_of_range("seed", self.seed, "less than 2**63")
        self._check_schedules()
        self._check_transfer()
        self._check_estimate()
        check_perturbation(self.perturbation, self.population_size, self.mirrored, self.by_episodes)

    def _check_schedules(self) -> None:
        """Refuse a schedule without an end, an end without a schedule, and one that cannot be reached."""
        for name, (kind, end) in SCHEDULED.items():
            is_constant, has_end = getattr(self, kind) == "constant", getattr(self, end) is not None
            if is_constant and has_end:
                raise ConfigError(
                    f"{end} is {getattr(self, end)}, but {name} is constant. Set {flag(kind)} to linear, exponential "
                    f"or cosine, or leave {flag(end)} away."
                )
            if not is_constant and not has_end:
                raise ConfigError(f"{kind} is {getattr(self, kind)!r}, but nothing says where to. Set {flag(end)}.")
            if has_end:
                start, quantity = getattr(self, name), kind.removesuffix("_schedule")
                make_schedule(quantity, getattr(self, kind), start, getattr(self, end), self.schedule_generations)

    def _check_transfer(self) -> None:
        """Refuse a primitive, or what concerns one, where there is no place for it."""
        if self.primitive is None:
            pass
        elif not isinstance(self.primitive, str) or not self.primitive:
            raise out_of_range("primitive", self.primitive, "the path of a run folder")
        elif self.level_names == ("primitive",):
            if self.freeze_primitive:
                raise ConfigError(
                    f"primitive is {self.primitive!r} and stays as it is, but a run of {self.env} has nothing else "
                    "that learns. Set --no-freeze-primitive: it then learns on."
                )
        elif self.level_names != ("controller", "primitive"):
            raise ConfigError(
                f"primitive is {self.primitive!r}, but a run of {self.env} with algorithm {self.algorithm!r} has the "
                f"levels {', '.join(self.level_names)} alone: a transferred primitive needs a controller. "
                "Leave --primitive away, or name another environment, e.g. ant-gather, with --algorithm shes."
            )
        if self.controller is not None:
            if not isinstance(self.controller, str) or not self.controller:
                raise out_of_range("controller", self.controller, "the path of a run folder")
            if "controller" not in self.level_names:
                raise ConfigError(
                    f"controller is {self.controller!r}, but a run of {self.env} with algorithm {self.algorithm!r} has "
                    f"the levels {', '.join(self.level_names)} alone. Leave --controller away, or name another "
                    "environment, e.g. ant-gather, with --algorithm shes."
                )
        if self.novelty != "none" and self.level_names == ("primitive",):
            raise ConfigError(
                f"novelty is {self.novelty!r}, but it concerns what the environment pays, and {self.env} trains a "
                "primitive alone, which its goals pay. Leave --novelty away."
            )

    def _check_estimate(self) -> None:
        """Refuse pairs where members are no pairs, and branches of a primitive that cannot be branched."""
        members = len(sign_matrix(self.mirrored, max(1, sum(self.by_episodes))))
        if self.fitness_shaping == "pair_rank" and members != 2:
            raise ConfigError(
                f"fitness_shaping 'pair_rank' ranks mirrored pairs, but with mirrored {self.mirrored!r} a group has "
                f"{members} member(s) here. Set --mirrored pair, or another --fitness-shaping."
            )
        if self.symmetry != "none" and self.primitive_view != "egocentric":
            raise ConfigError(
                f"symmetry is {self.symmetry!r}, but the primitive's view is {self.primitive_view!r}: only what is "
                "seen from the robot's own frame can be turned. Set --primitive-view egocentric, or --symmetry none."
            )
        if self.primitive_estimate != "interval" or "primitive" not in self.level_names:
            return
        if find_environment(self.env).has_own_physics:
            raise ConfigError(
                f"primitive_estimate is 'interval', but the physics of {self.env} is its own and cannot be "
                "branched. Set --primitive-estimate episode."
            )
        is_beside = self.level_names == ("controller", "primitive")
        if is_beside and self.learns[-1] and self.primitive_view == "observation":
            raise ConfigError(
                "primitive_estimate is 'interval', but the primitive sees the task's observation, which a branch does "
                "not go on with. Set --primitive-view egocentric or proprioception, or --primitive-estimate episode."
            )
        pairs = self.population_size if self.primitive_population_size is None else self.primitive_population_size
        if pairs % 2:
            name = "population_size" if self.primitive_population_size is None else "primitive_population_size"
            raise out_of_range(name, pairs, "an even number: branches are mirrored pairs")

    @property
    def by_episodes(self) -> tuple[bool, ...]:
        """Which levels whole episodes judge; a primitive alone that branches do counts, for the size of its pairs."""
        is_branched = self.primitive_estimate == "interval" and len(self.level_names) > 1
        return (*self.learns[:-1], False) if is_branched else self.learns

    @property
    def has_schedule(self) -> bool:
        """Whether anything changes over generations."""
        return any(getattr(self, kind) != "constant" for kind, _ in SCHEDULED.values())

    @property
    def level_names(self) -> tuple[str, ...]:
        """What the levels of the run are called."""
        if self.algorithm == "es":
            return ("policy",)
        return ("primitive",) if find_environment(self.env).sets_goals else ("controller", "primitive")

    @property
    def learns(self) -> tuple[bool, ...]:
        """Which levels learn."""
        is_frozen = self.primitive is not None and self.freeze_primitive
        return tuple(not (is_frozen and name == "primitive") for name in self.level_names)

    def is_over(self, generation: int, env_steps: int) -> bool:
        """Return whether a run of these settings ends after `generation` generations and `env_steps` of training."""
        return generation >= self.generations or (self.env_steps is not None and env_steps >= self.env_steps)

    @property
    def workers(self) -> int:
        """Worker processes asked for: `num_workers`, or one for every core that this process may use."""
        if self.num_workers:
            return self.num_workers
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON holds them."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a generation."""
        return {name: value for name, value in self.to_dict().items() if name not in EXECUTION_FIELDS}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainConfig:
        """Return the configuration that `to_dict` wrote.

        Raises:
            ConfigError: A key is unknown or missing, or a value is out of range.
        """
        values = in_words_of_today(values)
        check_fields(values)
        if "env" not in values:
            raise ConfigError("the configuration names no environment (key 'env').")
        settings: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**settings)


def in_words_of_today(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings that an earlier version may have written, with values of today.

    What did not say whether tied levels stay was written when they did not.
    """
    today = {name: value for name, value in values.items() if name != "external"}  # an environment's name is enough now
    return {"hold_tied": False, **today, **_FORMER.get(str(values.get("common_random_numbers")), {})}


def check_fields(names: Mapping[str, Any]) -> None:
    """Refuse names that are no settings.

    Raises:
        ConfigError: A name is unknown; the message names the nearest.
    """
    known = [field.name for field in fields(TrainConfig)]
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise ConfigError(f"unknown setting {name!r}.{hint} Settings: {', '.join(known)}.")


def _plain(value: Any) -> Any:
    """Return a NumPy number as Python's own, and a list as a tuple: JSON gives back what it was given."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value
