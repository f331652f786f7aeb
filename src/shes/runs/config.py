"""Every setting of a training run, in rooms. They stop here: the packages below take plain arguments."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.evolution.rooms import (
    SCHEDULED,
    EstimateSettings,
    EvolutionSettings,
    HierarchySettings,
    NetworkSettings,
    NoveltySettings,
    ScheduleSettings,
    TransferSettings,
)
from shes.algorithms.registry import ALGORITHMS, find_algorithm, learners
from shes.backends.registry import BACKENDS
from shes.cores import num_cores
from shes.envs.registry import ENVIRONMENTS, Environment, find_environment
from shes.envs.tasks.options import TaskOptions
from shes.errors import ConfigError
from shes.es.mirror import sign_matrix
from shes.es.perturbation import PERTURBATIONS
from shes.es.schedules import make_schedule
from shes.options import with_options
from shes.settings import (
    Choices,
    Execution,
    Ge,
    Gt,
    Lt,
    Setting,
    Settings,
    Shown,
    Unasked,
    flag,
    out_of_range,
    setting_fields,
)
from shes.sim.warp_device import DEVICES

__all__ = [
    "EpisodeSettings",
    "EvaluationSettings",
    "RunSettings",
    "TrainConfig",
    "WorkerSettings",
    "check_names",
    "execution_settings",
    "known_settings",
    "learner",
    "rooms_of",
]


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Run."""

    env: str
    """Environment; `shes envs` lists them. Or `gymnasium:` and an id of Gymnasium."""
    algorithm: Annotated[
        str,
        Choices(ALGORITHMS, "Register your own first: shes.register_algorithm, or --import MODULE."),
        Shown(everyday=True),
    ] = "shes"
    """shes: controller and primitive (on flagrun the primitive alone); es: one policy without goals, S-ES."""
    preset: Annotated[str, Execution(), Shown(everyday=True)] = "laptop"
    """What the other settings start from: paper, laptop or smoke."""
    seed: Annotated[int, Ge(0), Lt(2**63), Shown(everyday=True)] = 1
    """Seed of every random draw."""
    generations: Annotated[int, Ge(1), Execution(), Shown(everyday=True)] = 1000
    """Generations after which the run ends (Table I: 3000)."""
    env_steps: Annotated[int, Ge(1), Execution()] | None = None
    """Environment steps of training after whose generation the run ends, whichever comes first."""
    minutes: Annotated[float, Gt(0), Execution(), Shown(everyday=True)] | None = None
    """Minutes after which this call ends, whichever comes first."""

    def is_over(self, generation: int, env_steps: int) -> bool:
        """Return whether the run ends after `generation` generations and `env_steps` of training."""
        return generation >= self.generations or (self.env_steps is not None and env_steps >= self.env_steps)


@dataclass(frozen=True, kw_only=True)
class WorkerSettings(Settings):
    """Workers."""

    backend: Annotated[str, Choices(BACKENDS, is_described=True), Execution()] = "processes"
    """What runs the episodes on the CPU."""
    num_workers: Annotated[int, Ge(0), Execution(), Shown(flag="--workers", everyday=True)] = 0
    """Worker processes; 0 is one for every core. Never changes a number."""
    chunk_size: Annotated[int, Ge(0), Execution()] = 0
    """Policies that a worker, or a device, runs in lockstep; 0 chooses. Never changes a number on the CPU."""
    device: Annotated[str, Choices(("cpu", *DEVICES)), Execution(), Shown(everyday=True)] = "cpu"
    """What computes the physics: cpu, cuda (an NVIDIA card; extra gpu) or warp-cpu (extra warp; for tests)."""
    nconmax: Annotated[int, Ge(1), Execution()] | None = None
    """Contacts that a device has room for, per simulation on average; chosen by the world if none."""
    njmax: Annotated[int, Ge(1), Execution()] | None = None
    """Constraint rows that a device has room for, per simulation; chosen by the world if none."""

    @property
    def count(self) -> int:
        """Worker processes asked for: `num_workers`, or one for every core that this process may use."""
        return self.num_workers or num_cores()


@dataclass(frozen=True, kw_only=True)
class EpisodeSettings(Settings):
    """Episodes."""

    horizon: Annotated[int, Ge(1), Shown(everyday=True)] = 200
    """Control steps in an episode of training (Table I: 500)."""
    evaluation_horizon: Annotated[int, Ge(1)] | None = None
    """Control steps in an episode of evaluation; the same as in training if none."""
    evaluation_reset_noise: Annotated[float, Ge(0), Lt(1)] = 0.1
    """reset_noise in evaluation."""


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings(Settings):
    """Evaluation and checkpoints."""

    evaluation_interval: Annotated[int, Ge(1)] = 10
    """Generations between evaluations of the mean policies (there is one after the first generation, too)."""
    evaluation_episodes: Annotated[int, Ge(1)] = 50
    """Episodes of an evaluation."""
    keep_checkpoints: Annotated[int, Ge(1), Execution()] = 50
    """Generations between checkpoints that are kept beside `last` and `best`."""


_OF_EVERY_RUN: dict[str, type[Settings]] = {
    "run": RunSettings,
    "workers": WorkerSettings,
    "episodes": EpisodeSettings,
    "evaluation": EvaluationSettings,
}


class TrainConfig:
    """The settings of a training run: rooms, each a frozen dataclass. `config.evolution.sigma` is one.

    Every run has `run`, `workers`, `environment` (the options of its task), `episodes` and `evaluation`, and `body`
    where the robot has options. The others are those of its algorithm: a run of es has no `hierarchy`.
    """

    if TYPE_CHECKING:
        run: RunSettings
        workers: WorkerSettings
        environment: TaskOptions
        body: Settings
        episodes: EpisodeSettings
        evaluation: EvaluationSettings
        evolution: EvolutionSettings
        schedules: ScheduleSettings
        novelty: NoveltySettings
        networks: NetworkSettings
        hierarchy: HierarchySettings
        estimate: EstimateSettings
        transfer: TransferSettings

    def __init__(self, values: Mapping[str, Any]) -> None:
        """Make the rooms from settings by name.

        Raises:
            ConfigError: A setting is unknown, or its value is out of range, or values do not go together.
            UnknownNameError: A name is in no registry.
        """
        classes = check_names(values)
        self.__dict__["rooms"] = {room: cls.of(values) for room, cls in classes.items()}
        self._check()

    @classmethod
    def of(cls, **values: Any) -> TrainConfig:
        """Return the configuration with these settings: `TrainConfig.of(env="ant-gather", sigma=0.02)`."""
        return cls(values)

    def having(self, **values: Any) -> TrainConfig:
        """Return this configuration with other values of some settings."""
        return TrainConfig({**self.settings, **values})

    def __getattr__(self, name: str) -> Any:
        """Return a room."""
        rooms = self.__dict__.get("rooms", {})
        if name not in rooms:
            raise AttributeError(f"a run has no room of settings {name!r} here; it has {', '.join(rooms)}")
        return rooms[name]

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse: settings are never changed."""
        raise AttributeError(f"settings cannot be changed: {name}. Use having().")

    def __contains__(self, room: str) -> bool:
        """Tell whether there is a room of this name."""
        return room in self.rooms

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the rooms."""
        return iter(self.rooms)

    def __eq__(self, other: object) -> bool:
        """Tell whether every setting is the same."""
        return isinstance(other, TrainConfig) and self.rooms == other.rooms

    __hash__ = None  # type: ignore[assignment] - rooms may hold what cannot be hashed

    def __repr__(self) -> str:
        """Return the rooms."""
        return f"TrainConfig({', '.join(map(repr, self.rooms.values()))})"

    @property
    def settings(self) -> dict[str, Any]:
        """Every setting by its own name, whatever room it is in."""
        return {
            name: getattr(room, name)
            for room in self.rooms.values()
            for name, setting in setting_fields(type(room)).items()
            if not setting.has(Unasked)
        }

    def setting(self, name: str) -> Setting:
        """Return what there is to know of setting `name`."""
        return _settings_in(map(type, self.rooms.values()))[name]

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON holds them, room by room."""
        return {name: room.to_dict() for name, room in self.rooms.items()}

    @classmethod
    def from_dict(cls, rooms: Mapping[str, Mapping[str, Any]]) -> TrainConfig:
        """Return the configuration that `to_dict` wrote.

        Raises:
            ConfigError: A key is unknown or missing, or a value is not allowed.
        """
        for room, values in rooms.items():
            if not isinstance(values, Mapping):
                raise ConfigError(f"settings are kept in rooms, and {room!r} is none: {values!r}.")
        values = {name: value for room in rooms.values() for name, value in room.items()}
        config = cls(values)
        for room in rooms:
            if room not in config:
                raise ConfigError(f"a run of {config.run.env} has no room of settings {room!r}.")
            for name in rooms[room]:
                if name not in setting_fields(type(config.rooms[room])):
                    raise ConfigError(f"unknown setting {name!r} in room {room!r}.")
        return config

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a generation, by name, as JSON holds them."""
        values = {name: value for room in self.to_dict().values() for name, value in room.items()}
        return {name: value for name, value in values.items() if not self.setting(name).has(Execution)}

    # What follows from the settings.

    @property
    def level_names(self) -> tuple[str, ...]:
        """What the levels of the run are called."""
        return learner(self.run).level_names

    @property
    def learns(self) -> tuple[bool, ...]:
        """Which levels learn."""
        is_frozen = "transfer" in self and self.transfer.primitive is not None and self.transfer.freeze_primitive
        return tuple(not (is_frozen and name == "primitive") for name in self.level_names)

    @property
    def is_branched(self) -> bool:
        """Whether the primitive is judged by intervals, learning or not."""
        return "estimate" in self and self.estimate.primitive_estimate == "interval"

    @property
    def by_episodes(self) -> tuple[bool, ...]:
        """Which levels whole episodes judge; a primitive alone that branches do counts, for the size of its pairs."""
        return (*self.learns[:-1], False) if self.is_branched and len(self.level_names) > 1 else self.learns

    @property
    def has_schedule(self) -> bool:
        """Whether anything changes over generations."""
        return "schedules" in self and any(
            getattr(self.schedules, kind) != "constant" for kind, _ in SCHEDULED.values()
        )

    @property
    def evaluation_steps(self) -> int:
        """Control steps in an episode of evaluation."""
        return self.episodes.evaluation_horizon or self.episodes.horizon

    # What goes together.

    def _check(self) -> None:
        """Refuse settings that do not go together."""
        if self.workers.device != "cpu" and find_environment(self.run.env).has_own_physics:
            raise ConfigError(
                f"device is {self.workers.device!r}, but {self.run.env} has physics of its own: it runs on the CPU "
                "alone. Set --device cpu."
            )
        if "schedules" in self:
            self._check_schedules()
        if "transfer" in self and self.level_names == ("primitive",) and self.learns == (False,):
            raise ConfigError(
                f"primitive is {self.transfer.primitive!r} and stays as it is, but a run of {self.run.env} has nothing "
                "else that learns. Set --no-freeze-primitive: it then learns on."
            )
        if "evolution" in self:
            self._check_population()
        if self.is_branched:
            self._check_branches()

    def _check_schedules(self) -> None:
        """Refuse a schedule without an end, an end without a schedule, and one that cannot be reached."""
        values = self.settings
        for name, (kind, end) in SCHEDULED.items():
            is_constant, has_end = values[kind] == "constant", values[end] is not None
            if is_constant and has_end:
                raise ConfigError(
                    f"{end} is {values[end]}, but {name} is constant. Set {flag(kind)} to linear, exponential "
                    f"or cosine, or leave {flag(end)} away."
                )
            if not is_constant and not has_end:
                raise ConfigError(f"{kind} is {values[kind]!r}, but nothing says where to. Set {flag(end)}.")
            if has_end:
                quantity = kind.removesuffix("_schedule")
                generations = self.schedules.schedule_generations
                make_schedule(quantity, values[kind], values[name], values[end], generations)

    def _check_population(self) -> None:
        """Refuse a population that does not fit its groups, and pairs where members are no pairs."""
        evolution = self.evolution
        members = len(sign_matrix(evolution.mirrored, max(1, sum(self.by_episodes))))
        if evolution.fitness_shaping == "pair_rank" and members != 2:
            raise ConfigError(
                f"fitness_shaping 'pair_rank' ranks mirrored pairs, but with mirrored {evolution.mirrored!r} a group "
                f"has {members} member(s) here. Set --mirrored pair, or another --fitness-shaping."
            )
        if "hierarchy" in self and self.hierarchy.symmetry != "none" and self.hierarchy.primitive_view != "egocentric":
            raise ConfigError(
                f"symmetry is {self.hierarchy.symmetry!r}, but the primitive's view is "
                f"{self.hierarchy.primitive_view!r}: only what is seen from the robot's own frame can be turned. "
                "Set --primitive-view egocentric, or --symmetry none."
            )
        perturbation = self.hierarchy.perturbation if len(self.level_names) > 1 else "many_to_many"
        PERTURBATIONS.find(perturbation)().signs(0, evolution.population_size, evolution.mirrored, self.by_episodes)

    def _check_branches(self) -> None:
        """Refuse branches of a primitive that cannot be branched."""
        if find_environment(self.run.env).has_own_physics:
            raise ConfigError(
                f"primitive_estimate is 'interval', but the physics of {self.run.env} is its own and cannot be "
                "branched. Set --primitive-estimate episode."
            )
        is_beside = len(self.level_names) > 1
        if is_beside and self.learns[-1] and self.hierarchy.primitive_view == "observation":
            raise ConfigError(
                "primitive_estimate is 'interval', but the primitive sees the task's observation, which a branch does "
                "not go on with. Set --primitive-view egocentric or proprioception, or --primitive-estimate episode."
            )
        own = self.estimate.primitive_population_size if is_beside else None
        name, pairs = ("primitive_population_size", own) if own else ("population_size", self.evolution.population_size)
        if pairs % 2:
            raise out_of_range(name, pairs, "an even number: branches are mirrored pairs")


def learner(run: RunSettings) -> type[Algorithm[Any]]:
    """Return what learns in a run."""
    return find_algorithm(run.algorithm, sets_goals=find_environment(run.env).sets_goals)


def rooms_of(run: RunSettings) -> dict[str, type[Settings]]:
    """Return the classes of settings that a run has, by room, in the order of the help."""
    env = find_environment(run.env)
    body = env.body.Options if isinstance(env, Environment) else Settings
    return with_options(
        {
            "run": _OF_EVERY_RUN["run"],
            "workers": _OF_EVERY_RUN["workers"],
            **learner(run).rooms,
            "environment": env.options,
            **({"body": body} if setting_fields(body) else {}),
            "episodes": _OF_EVERY_RUN["episodes"],
            "evaluation": _OF_EVERY_RUN["evaluation"],
        }
    )


def _settings_in(classes: Iterable[type[Settings]]) -> dict[str, Setting]:
    """Return the settings of several classes by name, without what the program sets."""
    return {
        name: setting for cls in classes for name, setting in setting_fields(cls).items() if not setting.has(Unasked)
    }


def known_settings() -> dict[str, Setting]:
    """Return every setting of every algorithm, environment and body by name."""
    tasks = {cls: None for each in ENVIRONMENTS.values() for cls in (each.options, each.body.Options)}
    methods = [cls for each in learners() for cls in with_options(each.rooms).values()]
    return _settings_in([*with_options(_OF_EVERY_RUN).values(), *tasks, *methods])


def execution_settings() -> dict[str, Setting]:
    """Return the settings that say how, where and how long, by name: all that `resume` takes, and the preset."""
    return {
        name: each for name, each in _settings_in(with_options(_OF_EVERY_RUN).values()).items() if each.has(Execution)
    }


def check_names(values: Mapping[str, Any]) -> dict[str, type[Settings]]:
    """Return the rooms of a run with these settings; refuse names that are no settings, or none of this run.

    Raises:
        ConfigError: There is one; the message names the nearest.
    """
    if "env" not in values:
        raise ConfigError("the configuration names no environment (key 'env').")
    classes = rooms_of(RunSettings.of(values))
    here, everywhere = _settings_in(classes.values()), known_settings()
    for name, value in values.items():
        if name in here:
            continue
        if name in everywhere:
            raise ConfigError(
                f"{name} is no setting of a run of {values['env']} with algorithm "
                f"{values.get('algorithm', 'shes')!r}, got {value!r}. Leave {everywhere[name].flag} away."
            )
        close = difflib.get_close_matches(name, here, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise ConfigError(f"unknown setting {name!r}.{hint} Settings: {', '.join(here)}.")
    return classes
