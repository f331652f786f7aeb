"""The settings of a run, in sections: one frozen dataclass each.

Every run has the sections below, `environment` (the options of its task) and `body` if the robot has options. The
others are those of its algorithm: a run of es has no `hierarchy`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.registry import ALGORITHMS, PRESET_NAMES, algorithm_classes, find_algorithm
from shes.backends.named_backends import BACKENDS
from shes.cores import num_cores
from shes.envs.registry import ENVIRONMENTS, Environment, find_environment
from shes.errors import ConfigError
from shes.options import with_options
from shes.settings import Choices, Execution, Ge, Gt, Lt, Setting, Settings, Shared, Shown, Unasked, setting_fields
from shes.sim.warp_device import DEVICES


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Run."""

    env: str
    """Environment name (see `shes envs`) or `gymnasium:ID`."""
    algorithm: Annotated[
        str,
        Choices(ALGORITHMS, "Register your own first: shes.register_algorithm, or --import MODULE.", is_described=True),
        Shown(everyday=True),
    ] = "shes"
    """Algorithm."""
    preset: Annotated[str, Choices(PRESET_NAMES), Execution(), Shown(everyday=True)] = "laptop"
    """Preset of the other settings."""
    seed: Annotated[int, Ge(0), Lt(2**63), Shown(everyday=True)] = 1
    """Seed of every random draw."""
    generations: Annotated[int, Ge(1), Execution(), Shown(everyday=True)] = 1000
    """Generations after which the run ends (Table I: 3000)."""
    env_steps: Annotated[int, Ge(1), Execution()] | None = None
    """Environment steps of training; the run ends with the generation that reaches them, if not before."""
    minutes: Annotated[float, Gt(0), Execution(), Shown(everyday=True)] | None = None
    """Minutes after which this call ends, if not before."""
    max_diverged_generations: Annotated[int, Ge(1), Execution()] = 10
    """Generations in a row in which every episode diverges (NaN) after which the run ends with an error."""

    def is_over(self, generation: int, env_steps: int) -> bool:
        """Return whether a run ends after `generation` generations and `env_steps` environment steps."""
        return generation >= self.generations or (self.env_steps is not None and env_steps >= self.env_steps)


@dataclass(frozen=True, kw_only=True)
class WorkerSettings(Settings):
    """Workers."""

    backend: Annotated[str, Choices(BACKENDS, is_described=True), Execution()] = "processes"
    """What runs the episodes on the CPU."""
    num_workers: Annotated[int, Ge(0), Execution(), Shown(flag="--workers", everyday=True)] = 0
    """Worker processes; 0 is one for every core. Does not affect results."""
    chunk_size: Annotated[int, Ge(0), Execution()] = 0
    """Policies that a worker or a device runs in lockstep; 0 is automatic. Does not affect results on the CPU."""
    device: Annotated[str, Choices(("cpu", *DEVICES)), Execution(), Shown(everyday=True)] = "cpu"
    """Device of the physics: cpu, cuda (an NVIDIA GPU; extra gpu) or warp-cpu (extra warp; for tests)."""
    nconmax: Annotated[int, Ge(1), Execution()] | None = None
    """Contact buffer of a device, per simulation on average; by default chosen for the environment's model."""
    njmax: Annotated[int, Ge(1), Execution()] | None = None
    """Constraint buffer of a device, in rows per simulation; by default chosen for the environment's model."""

    @property
    def count(self) -> int:
        """Number of worker processes: `num_workers`, or one for every core that this process may use."""
        return self.num_workers or num_cores()


@dataclass(frozen=True, kw_only=True)
class EpisodeSettings(Settings):
    """Episodes."""

    horizon: Annotated[int, Ge(1)] = 200
    """Control steps in an episode of training (Table I: 500)."""
    evaluation_horizon: Annotated[int, Ge(1)] | None = None
    """Control steps in an episode of evaluation; as in training if none."""
    evaluation_reset_noise: Annotated[float, Ge(0), Lt(1)] = 0.1
    """Reset noise in evaluation episodes."""


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings(Settings):
    """Evaluation and checkpoints."""

    evaluation_interval: Annotated[int, Ge(1)] = 10
    """Generations between evaluations of the mean policies; the first generation is evaluated, too."""
    evaluation_episodes: Annotated[int, Ge(1)] = 50
    """Episodes of an evaluation."""
    keep_checkpoints: Annotated[int, Ge(1), Execution()] = 50
    """Generations between the checkpoints kept beside `last` and `best`."""


_NO_ENVIRONMENT = "the configuration names no environment (key 'env')."
_OF_EVERY_RUN: dict[str, type[Settings]] = {
    "run": RunSettings,
    "workers": WorkerSettings,
    "episodes": EpisodeSettings,
    "evaluation": EvaluationSettings,
}


def algorithm_of(run: RunSettings) -> type[Algorithm[Any]]:
    """Return the algorithm of a run; raise ConfigError if it sets goals where the environment does."""
    sets_goals = find_environment(run.env).sets_goals
    found = find_algorithm(run.algorithm, sets_goals=sets_goals)
    if sets_goals and "controller" in found.level_names:
        fitting = [name for name in ALGORITHMS if "controller" not in find_algorithm(name, sets_goals=True).level_names]
        raise ConfigError(
            f"{run.env} sets the goals, so the controller of {run.algorithm} has nothing to learn. "
            f"Set --algorithm to {', '.join(fitting[:-1])} or {fitting[-1]}."
        )
    return found


def sections_of(run: RunSettings) -> dict[str, type[Settings]]:
    """Return the settings classes of a run by section, in the order of the help; raise ConfigError if names clash."""
    env = find_environment(run.env)
    body = env.body.Options if isinstance(env, Environment) else Settings
    sections = with_options(
        {
            "run": RunSettings,
            "workers": WorkerSettings,
            **algorithm_of(run).sections,
            "environment": env.options,
            **({"body": body} if setting_fields(body) else {}),
            "episodes": EpisodeSettings,
            "evaluation": EvaluationSettings,
        }
    )
    _check_distinct(sections)
    return sections


def _check_distinct(sections: Mapping[str, type[Settings]]) -> None:
    """Raise ConfigError if settings of different sections have one name, unless it is a shared setting."""
    first: dict[str, tuple[str, Setting]] = {}
    for section, cls in sections.items():
        for name, setting in settings_in([cls]).items():
            home, other = first.setdefault(name, (section, setting))
            if home == section or (setting.has(Shared) and setting.default == other.default):
                continue
            fix = "Give both the same default" if setting.has(Shared) else "Choose another name for one of them"
            raise ConfigError(
                f"{name!r} is a setting of section {home!r} (default {other.default!r}) and another one of section "
                f"{section!r} (default {setting.default!r}, {setting.owner.__qualname__}). {fix}."
            )


def settings_in(classes: Iterable[type[Settings]]) -> dict[str, Setting]:
    """Return the settings of several classes by name, without `Unasked` fields."""
    return {name: setting for cls in classes for name, setting in _asked(cls).items()}


@cache
def _asked(cls: type[Settings]) -> dict[str, Setting]:
    return {name: setting for name, setting in setting_fields(cls).items() if not setting.has(Unasked)}


def known_settings() -> dict[str, Setting]:
    """Return every setting of every algorithm, environment and body by name."""
    tasks = {cls: None for each in ENVIRONMENTS.values() for cls in (each.options, each.body.Options)}
    methods = [cls for each in algorithm_classes() for cls in with_options(each.sections).values()]
    return settings_in([*with_options(_OF_EVERY_RUN).values(), *tasks, *methods])


def execution_settings() -> dict[str, Setting]:
    """Return the settings that do not change the numbers of a run, by name."""
    settings = settings_in(with_options(_OF_EVERY_RUN).values())
    return {name: each for name, each in settings.items() if each.has(Execution)}


def check_names(values: Mapping[str, Any]) -> dict[str, type[Settings]]:
    """Return the settings classes of a run by section; raise ConfigError unless all names in `values` are settings."""
    if "env" not in values:
        raise ConfigError(_NO_ENVIRONMENT)
    classes = sections_of(RunSettings.of(values))
    here = settings_in(classes.values())
    _check_choices(here, values)
    for name in values:
        if name not in here:
            raise _not_here(name, values, here)
    return classes


def check_record(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, type[Settings]]:
    """Return the settings classes of a run with this record, by section.

    A missing setting takes its default. A setting that was deleted by hand is detected, because checkpoints store the
    settings too.

    Raises:
        ConfigError: A section or a setting is unknown.
        UnknownNameError: A value is an unknown name.
    """
    for section, values in sections.items():
        if not isinstance(values, Mapping):
            raise ConfigError(f"{section!r} must be an object of settings, got {values!r}.")
    run = sections.get("run", {})
    if "env" not in run:
        raise ConfigError(_NO_ENVIRONMENT)
    classes = sections_of(RunSettings.of(run))
    settings = {section: settings_in([cls]) for section, cls in classes.items()}
    for section, values in sections.items():
        if section not in classes:
            raise ConfigError(f"a run of {run['env']} has no section of settings {section!r}.")
        _check_choices(settings[section], values)
        for name in values:
            if name not in settings[section]:
                raise _unknown(name, settings[section], f" in section {section!r}")
    return classes


def _check_choices(settings: Mapping[str, Setting], values: Mapping[str, Any]) -> None:
    """Raise for a value that is not one of its setting's names: a class that is not registered may have options."""
    for name, setting in settings.items():
        if name in values and setting.has(Choices):
            setting.checked(values[name])


def _not_here(name: str, values: Mapping[str, Any], here: Mapping[str, Setting]) -> ConfigError:
    """Return the error for setting `name`, which is none of the settings `here` of a run with `values`."""
    everywhere = known_settings()
    if name not in everywhere:
        return _unknown(name, here)
    algorithm = values.get("algorithm", RunSettings.algorithm)
    return ConfigError(
        f"{name} is not a setting of a run of {values['env']} with algorithm {algorithm!r}, "
        f"got {values[name]!r}. Omit {everywhere[name].flag}."
    )


def _unknown(name: str, known: Iterable[str], where: str = "") -> ConfigError:
    """Return the error for the unknown setting `name`, with the nearest of the `known` names."""
    close = difflib.get_close_matches(name, known, n=3)
    hint = f"Did you mean {close[0]!r}?" if close else "`shes train ENV --help-all` lists the settings."
    similar = f" Similar: {', '.join(close[1:])}." if close[1:] else ""
    return ConfigError(f"unknown setting {name!r}{where}. {hint}{similar}")
