"""The configuration of a training run. Settings objects stop here: the packages below take plain arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from shes.algorithms.contract import Algorithm
from shes.envs.named_environments import find_environment
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError
from shes.runs.run_settings import (
    EpisodeSettings,
    EvaluationSettings,
    RunSettings,
    WorkerSettings,
    algorithm_of,
    by_name,
    check_names,
    sections_of,
    settings_by_section,
    unknown_setting,
)
from shes.settings import Execution, Setting, Settings, Unasked, setting_fields


@dataclass(frozen=True, init=False)
class TrainConfig:
    """The settings of a training run in sections: `config.run.seed`. See `shes.runs.run_settings`."""

    run: RunSettings
    workers: WorkerSettings
    environment: TaskOptions
    episodes: EpisodeSettings
    evaluation: EvaluationSettings
    sections: Mapping[str, Settings]
    """All sections by name, these and those of the algorithm."""
    options: Mapping[str, Mapping[str, Any]]
    """Options of registered classes, such as backends, by section and name."""

    def __init__(self, sections: Mapping[str, Settings], options: Mapping[str, Mapping[str, Any]]) -> None:
        self.__dict__.update(sections, sections=sections, options=options)

    @classmethod
    def of(cls, **values: Any) -> TrainConfig:
        """Return the configuration with these settings: `TrainConfig.of(env="ant-gather", sigma=0.02)`.

        Raises:
            ConfigError: A setting is unknown, a value is out of range, or two values do not go together.
            UnknownNameError: A value is a name that is in no registry.
        """
        known = check_names(values)
        sections = {name: each.of(values) for name, each in sections_of(RunSettings.of(values)).items()}
        options = {
            section: {
                name: each.checked(values.get(name, each.default))
                for name, each in known[section].items()
                if name not in setting_fields(type(own))
            }
            for section, own in sections.items()
        }
        config = cls(sections, options)
        config._check()
        return config

    @classmethod
    def from_dict(cls, sections: Mapping[str, Mapping[str, Any]]) -> TrainConfig:
        """Return the configuration from the result of `to_dict`. A missing setting has its default.

        Raises:
            ConfigError: A key is unknown, a value is not allowed, or a shared setting has two values.
            UnknownNameError: A value is a name that is in no registry.
        """
        values: dict[str, Any] = {}
        for section, own in sections.items():
            if not isinstance(own, Mapping):
                raise ConfigError(f"{section!r} must be an object of settings, got {own!r}.")
            for name, value in own.items():
                if values.setdefault(name, value) != value:
                    raise ConfigError(
                        f"{name} is {values[name]!r} in one section and {value!r} in section {section!r}. "
                        "It is one setting: give both the same value."
                    )
        known = check_names(values)
        for section, own in sections.items():
            if section not in known:
                raise ConfigError(f"a run of {values['env']} has no section of settings {section!r}.")
            for name in own:
                if name not in known[section]:
                    raise unknown_setting(name, known[section], f" in section {section!r}")
        return cls.of(**values)

    def having(self, **values: Any) -> TrainConfig:
        """Return a copy with other values of some settings."""
        return TrainConfig.of(**{**self.values, **values})

    def __getattr__(self, name: str) -> Any:
        sections = self.__dict__.get("sections", {})
        raise AttributeError(f"a run has no section of settings {name!r} here; it has {', '.join(sections)}")

    def __contains__(self, section: str) -> bool:
        return section in self.sections

    @cached_property
    def values(self) -> dict[str, Any]:
        """The values of all settings by name."""
        values = {name: value for own in self.options.values() for name, value in own.items()}
        for own in self.sections.values():
            asked = (each.name for each in setting_fields(type(own)).values() if not each.has(Unasked))
            values |= {name: getattr(own, name) for name in asked}
        return values

    def setting(self, name: str) -> Setting:
        """Return the description of setting `name`."""
        return by_name(settings_by_section(self.run))[name]

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the settings as JSON types, by section."""
        return {
            section: {name: _as_json(self.values[name]) for name in settings}
            for section, settings in settings_by_section(self.run).items()
        }

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a run, by name, as JSON types."""
        settings = by_name(settings_by_section(self.run))
        return {name: _as_json(self.values[name]) for name, each in settings.items() if not each.has(Execution)}

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

    def _check(self) -> None:
        """Raise ConfigError for settings that do not go together."""
        if self.workers.device != "cpu" and find_environment(self.run.env).has_own_physics:
            raise ConfigError(
                f"device is {self.workers.device!r}, but {self.run.env} has physics of its own: it runs on the CPU "
                "alone. Set --device cpu."
            )
        self.algorithm.check(self)


def _as_json(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
