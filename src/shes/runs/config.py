"""The configuration of a training run. Settings objects stop here: the packages below take plain arguments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
from shes.envs.registry import find_environment
from shes.envs.tasks.options import TaskOptions
from shes.errors import ConfigError
from shes.es.mirror import sign_matrix
from shes.es.perturbation import PERTURBATIONS
from shes.runs.rooms import (
    EpisodeSettings,
    EvaluationSettings,
    RunSettings,
    WorkerSettings,
    check_names,
    check_record,
    learner,
    settings_in,
)
from shes.settings import Execution, Setting, Settings, flag, out_of_range

_WHOLE_GROUPS = 48
"""Members of a population that has whole mirrored groups, however they are mirrored and perturbed."""


class TrainConfig:
    """The settings of a training run, immutable, in rooms: `config.evolution.sigma`. See `shes.runs.rooms`."""

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
        """Build the rooms from settings by name.

        Raises:
            ConfigError: A setting is unknown, a value is out of range, or two values do not go together.
            UnknownNameError: A value is a name that is in no registry.
        """
        classes = check_names(values)
        self._set({room: cls.of(values) for room, cls in classes.items()})

    def _set(self, rooms: dict[str, Settings]) -> None:
        self.__dict__["rooms"] = rooms
        self._check()

    @classmethod
    def of(cls, **values: Any) -> TrainConfig:
        """Return the configuration with these settings: `TrainConfig.of(env="ant-gather", sigma=0.02)`."""
        return cls(values)

    def having(self, **values: Any) -> TrainConfig:
        """Return a copy with other values of some settings."""
        return TrainConfig({**self.settings, **values})

    def __getattr__(self, name: str) -> Any:
        rooms = self.__dict__.get("rooms", {})
        if name not in rooms:
            raise AttributeError(f"a run has no room of settings {name!r} here; it has {', '.join(rooms)}")
        return rooms[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"settings cannot be changed: {name}. Use having().")

    def __contains__(self, room: str) -> bool:
        return room in self.rooms

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TrainConfig) and self.rooms == other.rooms

    __hash__ = None  # type: ignore[assignment] - a room may not be hashable

    def __repr__(self) -> str:
        return f"TrainConfig({', '.join(map(repr, self.rooms.values()))})"

    @property
    def settings(self) -> dict[str, Any]:
        """The values of all settings by name."""
        return {name: getattr(room, name) for room in self.rooms.values() for name in settings_in([type(room)])}

    def setting(self, name: str) -> Setting:
        """Return the description of setting `name`."""
        return settings_in(map(type, self.rooms.values()))[name]

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON types, by room."""
        return {name: room.to_dict() for name, room in self.rooms.items()}

    @classmethod
    def from_dict(cls, rooms: Mapping[str, Mapping[str, Any]]) -> TrainConfig:
        """Return the configuration from the result of `to_dict`.

        Raises:
            ConfigError: A key is unknown, a value is not allowed, or a shared setting has two values.
            UnknownNameError: A value is a name that is in no registry.
        """
        classes = check_record(rooms)
        config = cls.__new__(cls)
        config._set({room: made(**rooms.get(room, {})) for room, made in classes.items()})
        return config

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the record, because a room with options of registered classes is a class made at run time."""
        return TrainConfig.from_dict, (self.to_dict(),)

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a run, by name, as JSON types."""
        settings = settings_in(map(type, self.rooms.values()))
        values = {name: value for room in self.to_dict().values() for name, value in room.items()}
        return {name: value for name, value in values.items() if not settings[name].has(Execution)}

    # Derived properties.

    @property
    def level_names(self) -> tuple[str, ...]:
        """The names of the levels of the run."""
        return learner(self.run).level_names

    @property
    def learns(self) -> tuple[bool, ...]:
        """Whether each level learns."""
        is_frozen = "transfer" in self and self.transfer.primitive is not None and self.transfer.freeze_primitive
        return tuple(not (is_frozen and name == "primitive") for name in self.level_names)

    @property
    def is_branched(self) -> bool:
        """Whether the primitive's fitness is estimated by branched intervals, even if it does not learn."""
        return "estimate" in self and self.estimate.primitive_estimate == "interval"

    @property
    def by_episodes(self) -> tuple[bool, ...]:
        """Whether each level's mirrored groups are those of whole episodes; true for a primitive that learns alone."""
        return (*self.learns[:-1], False) if self.is_branched and len(self.level_names) > 1 else self.learns

    @property
    def has_schedule(self) -> bool:
        """Whether a setting changes over generations."""
        return "schedules" in self and any(
            getattr(self.schedules, kind) != "constant" for kind, _ in SCHEDULED.values()
        )

    @property
    def evaluation_steps(self) -> int:
        """Control steps in an episode of evaluation."""
        return self.episodes.evaluation_horizon or self.episodes.horizon

    # Checks of combinations.

    def _check(self) -> None:
        """Raise ConfigError for settings that do not go together."""
        self._check_shared()
        if self.workers.device != "cpu" and find_environment(self.run.env).has_own_physics:
            raise ConfigError(
                f"device is {self.workers.device!r}, but {self.run.env} has physics of its own: it runs on the CPU "
                "alone. Set --device cpu."
            )
        if "schedules" in self:
            self._check_schedules()
        if "transfer" in self and self.level_names == ("primitive",) and self.learns == (False,):
            raise ConfigError(
                f"the primitive {self.transfer.primitive!r} is frozen, so nothing would learn in a run of "
                f"{self.run.env}. Set --no-freeze-primitive to train it further."
            )
        if "evolution" in self:
            self._check_population()
        if self.is_branched:
            self._check_branches()

    def _check_shared(self) -> None:
        """Check that a setting of two rooms has one value."""
        first: dict[str, tuple[str, Any]] = {}
        for room, settings in self.rooms.items():
            for name in settings_in([type(settings)]):
                value = getattr(settings, name)
                home, other = first.setdefault(name, (room, value))
                if value != other:
                    raise ConfigError(
                        f"{name} is {other!r} in room {home!r}, but {value!r} in room {room!r}. It is one setting: "
                        "give both the same value."
                    )

    def _check_schedules(self) -> None:
        """Check that every schedule has a valid end value and that constant settings have none."""
        values = self.settings
        for name, (kind, end) in SCHEDULED.items():
            is_constant, has_end = values[kind] == "constant", values[end] is not None
            if is_constant and has_end:
                raise ConfigError(
                    f"{end} is {values[end]}, but {name} is constant. Set {flag(kind)} to linear, exponential "
                    f"or cosine, or omit {flag(end)}."
                )
            if not is_constant and not has_end:
                raise ConfigError(f"{kind} is {values[kind]!r}, but {end} is not set. Set {flag(end)}.")
            if values[kind] == "exponential" and not values[end]:
                raise ConfigError(
                    f"the end of the exponential schedule of {name} must be positive, got {values[end]}. "
                    f"Set {flag(kind)} to another one, or change {flag(end)}."
                )

    def _check_population(self) -> None:
        """Check that the population consists of whole mirrored groups, and fits shaping and symmetry."""
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
        # A population of the same remainder tells as much, without an array of every member.
        small = min(evolution.population_size, _WHOLE_GROUPS + evolution.population_size % _WHOLE_GROUPS)
        try:
            PERTURBATIONS.find(perturbation)().signs(0, small, evolution.mirrored, self.by_episodes)
        except ConfigError:  # the message is to have the size that was asked for
            PERTURBATIONS.find(perturbation)().signs(0, evolution.population_size, evolution.mirrored, self.by_episodes)

    def _check_branches(self) -> None:
        """Check that the primitive's episodes can be branched."""
        if find_environment(self.run.env).has_own_physics:
            raise ConfigError(
                f"primitive_estimate is 'interval', but the physics of {self.run.env} is its own and cannot be "
                "branched. Set --primitive-estimate episode."
            )
        is_beside = len(self.level_names) > 1
        if is_beside and self.learns[-1] and self.hierarchy.primitive_view == "observation":
            raise ConfigError(
                "primitive_estimate is 'interval', but the primitive sees the task's observation, which a branch does "
                "not continue. Set --primitive-view egocentric or proprioception, or --primitive-estimate episode."
            )
        own = self.estimate.primitive_population_size if is_beside else None
        name, pairs = ("primitive_population_size", own) if own else ("population_size", self.evolution.population_size)
        if pairs % 2:
            raise out_of_range(name, pairs, "an even number: branches are mirrored pairs")
