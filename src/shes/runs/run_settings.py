"""The settings of a run, in sections: one frozen dataclass each.

Every run has the sections below, `environment` (the options of its task) and `body` if the robot has options. The
others are those of its algorithm: a run of es has no `hierarchy`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from shes.algorithms.contract import Algorithm
from shes.backends.named_backends import BACKENDS
from shes.envs.named_environments import ENVIRONMENTS, Environment, find_environment
from shes.errors import ConfigError
from shes.machine import num_cores
from shes.options import with_options
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES, algorithm_classes, find_algorithm
from shes.settings import Choices, Execution, Ge, Gt, Lt, Setting, Settings, Shared, Shown
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


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings(Settings):
    """Evaluation and checkpoints."""

    evaluation_interval: Annotated[int, Ge(1)] = 10
    """Generations between evaluations of the mean policies; the first generation is evaluated, too."""
    evaluation_episodes: Annotated[int, Ge(1)] = 50
    """Episodes of an evaluation."""
    keep_checkpoints: Annotated[int, Ge(1), Execution()] = 50
    """Generations between the checkpoints that are kept in addition to `last` and `best`."""


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
    """Return the settings classes of a run by section, in the order of the help."""
    env = find_environment(run.env)
    body = {"body": env.body.Options} if isinstance(env, Environment) and env.body.Options is not Settings else {}
    of_episodes = {"episodes": EpisodeSettings, "evaluation": EvaluationSettings}
    first: dict[str, type[Settings]] = {"run": RunSettings, "workers": WorkerSettings}
    return {**first, **algorithm_of(run).sections, "environment": env.options, **body, **of_episodes}


def settings_by_section(run: RunSettings) -> dict[str, dict[str, Setting]]:
    """Return the settings of a run by section and name.

    Raises:
        ConfigError: Settings of different sections have one name, and are not one shared setting.
    """
    found = with_options(sections_of(run))
    first: dict[str, tuple[str, Setting]] = {}
    for section, settings in found.items():
        for name, setting in settings.items():
            home, other = first.setdefault(name, (section, setting))
            if home == section or (setting.has(Shared) and setting.default == other.default):
                continue
            fix = "Give both the same default" if setting.has(Shared) else "Choose another name for one of them"
            raise ConfigError(
                f"{name!r} is a setting of section {home!r} (default {other.default!r}) and another one of section "
                f"{section!r} (default {setting.default!r}, {setting.owner.__qualname__}). {fix}."
            )
    return found


def by_name(sections: Mapping[str, Mapping[str, Setting]]) -> dict[str, Setting]:
    """Return the settings of all `sections` by name."""
    return {name: setting for settings in sections.values() for name, setting in settings.items()}


def known_settings() -> dict[str, Setting]:
    """Return every setting of every algorithm, environment and body by name."""
    tasks = {str(cls): cls for each in ENVIRONMENTS.values() for cls in (each.options, each.body.Options)}
    sections = [_OF_EVERY_RUN, tasks, *(each.sections for each in algorithm_classes())]
    return {name: setting for each in sections for name, setting in by_name(with_options(each)).items()}


def execution_settings() -> dict[str, Setting]:
    """Return the settings that do not change the numbers of a run, by name."""
    return {name: each for name, each in by_name(with_options(_OF_EVERY_RUN)).items() if each.has(Execution)}


def check_names(values: Mapping[str, Any]) -> dict[str, dict[str, Setting]]:
    """Return the settings of a run with `values`; raise ConfigError unless all names in `values` are among them."""
    if "env" not in values:
        raise ConfigError("the configuration names no environment (key 'env').")
    sections = settings_by_section(RunSettings.of(values))
    here = by_name(sections)
    for name, setting in here.items():
        if name in values and setting.has(Choices):
            setting.checked(values[name])  # first: a class that is not registered may have options
    for name in values:
        if name in here:
            continue
        everywhere = known_settings()
        if name not in everywhere:
            raise unknown_setting(name, here)
        raise ConfigError(
            f"{name} is not a setting of a run of {values['env']} with algorithm "
            f"{values.get('algorithm', RunSettings.algorithm)!r}, got {values[name]!r}. Omit {everywhere[name].flag}."
        )
    return sections


def unknown_setting(name: str, known: Iterable[str], where: str = "") -> ConfigError:
    """Return the error for the unknown setting `name`, with the nearest of the `known` names."""
    close = difflib.get_close_matches(name, known, n=3)
    hint = f"Did you mean {close[0]!r}?" if close else "`shes train ENV --help-all` lists the settings."
    similar = f" Similar: {', '.join(close[1:])}." if close[1:] else ""
    return ConfigError(f"unknown setting {name!r}{where}. {hint}{similar}")
