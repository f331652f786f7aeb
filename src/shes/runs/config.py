"""The configuration of a training run. Settings objects stop here: the packages below take plain arguments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.contract import Algorithm
from shes.envs.registry import find_environment
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError
from shes.runs.sections import (
    EpisodeSettings,
    EvaluationSettings,
    RunSettings,
    WorkerSettings,
    algorithm_of,
    check_names,
    check_record,
    settings_in,
)
from shes.settings import Execution, Setting, Settings


class TrainConfig:
    """The settings of a training run, immutable, in sections: `config.run.seed`. See `shes.runs.sections`."""

    run: RunSettings
    workers: WorkerSettings
    environment: TaskOptions
    body: Settings
    episodes: EpisodeSettings
    evaluation: EvaluationSettings

    def __init__(self, values: Mapping[str, Any]) -> None:
        """Build the sections from settings by name.

        Raises:
            ConfigError: A setting is unknown, a value is out of range, or two values do not go together.
            UnknownNameError: A value is a name that is in no registry.
        """
        classes = check_names(values)
        self._set({section: cls.of(values) for section, cls in classes.items()})

    def _set(self, sections: dict[str, Settings]) -> None:
        self.__dict__["sections"] = sections
        self._check()

    @classmethod
    def of(cls, **values: Any) -> TrainConfig:
        """Return the configuration with these settings: `TrainConfig.of(env="ant-gather", sigma=0.02)`."""
        return cls(values)

    def having(self, **values: Any) -> TrainConfig:
        """Return a copy with other values of some settings."""
        return TrainConfig({**self.values, **values})

    def __getattr__(self, name: str) -> Any:
        sections = self.__dict__.get("sections", {})
        if name not in sections:
            raise AttributeError(f"a run has no section of settings {name!r} here; it has {', '.join(sections)}")
        return sections[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"settings cannot be changed: {name}. Use having().")

    def __contains__(self, section: str) -> bool:
        return section in self.sections

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TrainConfig) and self.sections == other.sections

    __hash__ = None  # type: ignore[assignment] - a section may not be hashable

    def __repr__(self) -> str:
        return f"TrainConfig({', '.join(map(repr, self.sections.values()))})"

    @property
    def values(self) -> dict[str, Any]:
        """The values of all settings by name."""
        return {
            name: getattr(section, name) for section in self.sections.values() for name in settings_in([type(section)])
        }

    def setting(self, name: str) -> Setting:
        """Return the description of setting `name`."""
        return settings_in(map(type, self.sections.values()))[name]

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON types, by section."""
        return {name: section.to_dict() for name, section in self.sections.items()}

    @classmethod
    def from_dict(cls, sections: Mapping[str, Mapping[str, Any]]) -> TrainConfig:
        """Return the configuration from the result of `to_dict`.

        Raises:
            ConfigError: A key is unknown, a value is not allowed, or a shared setting has two values.
            UnknownNameError: A value is a name that is in no registry.
        """
        classes = check_record(sections)
        config = cls.__new__(cls)
        config._set({section: made(**sections.get(section, {})) for section, made in classes.items()})
        return config

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the record, because a section with options of registered classes is a class made at run time."""
        return TrainConfig.from_dict, (self.to_dict(),)

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a run, by name, as JSON types."""
        settings = settings_in(map(type, self.sections.values()))
        values = {name: value for section in self.to_dict().values() for name, value in section.items()}
        return {name: value for name, value in values.items() if not settings[name].has(Execution)}

    # Derived properties.

    @property
    def algorithm(self) -> type[Algorithm[Any]]:
        """The class of the run's algorithm."""
        return algorithm_of(self.run)

    @property
    def level_names(self) -> tuple[str, ...]:
        """The names of the levels of the run."""
        return self.algorithm.level_names

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
        self.algorithm.check(self)

    def _check_shared(self) -> None:
        """Check that a setting of two sections has one value."""
        first: dict[str, tuple[str, Any]] = {}
        for section, settings in self.sections.items():
            for name in settings_in([type(settings)]):
                value = getattr(settings, name)
                home, other = first.setdefault(name, (section, value))
                if value != other:
                    raise ConfigError(
                        f"{name} is {other!r} in section {home!r}, but {value!r} in section {section!r}. "
                        "It is one setting: give both the same value."
                    )
