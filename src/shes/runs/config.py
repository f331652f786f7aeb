"""The settings of a run, in sections. Settings objects stop here: the packages below take plain arguments.

Every run has the sections of the classes below, `environment` (the options of its task) and `body` if the robot has
options. The others are those of its algorithm: a run of es has no `hierarchy`.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from shes.algorithms.contract import Algorithm
from shes.backends.named_backends import BACKENDS
from shes.envs.bodies.robot_file import read_robot, robot_stem
from shes.envs.external_task import ExternalOptions
from shes.envs.named_environments import ENVIRONMENTS, ROBOT_ENVIRONMENTS, Environment, find_environment
from shes.envs.tasks.task import TaskOptions
from shes.errors import ConfigError
from shes.machine import num_cores
from shes.options import with_options
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES, algorithm_classes, find_algorithm
from shes.settings import Choices, Execution, Ge, Gt, Needs, Setting, Settings, Shared, Shown
from shes.sim.warp_device import DEVICES


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Run."""

    env: str
    """Environment name (see `shes envs`) or `gymnasium:ID`."""
    algorithm: Annotated[str, Choices(ALGORITHMS), Shown(everyday=True)] = "shes"
    """Algorithm."""
    preset: Annotated[str, Choices(PRESET_NAMES), Execution(), Shown(everyday=True)] = "laptop"
    """Preset of the other settings. `paper` has the values of the SHES paper, most of them in its Table I."""
    seed: Annotated[int, Ge(0), Shown(everyday=True)] = 1
    """Seed of every random draw."""
    generations: Annotated[int, Ge(1), Execution(), Shown(everyday=True)] = 1000
    """Generations after which the run ends (the SHES paper's Table I: 3000)."""
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

    backend: Annotated[str, Choices(BACKENDS), Execution()] = "processes"
    """Engine that runs the episodes on the CPU."""
    num_workers: Annotated[int, Ge(0), Execution(), Shown(flag="--workers", everyday=True)] = 0
    """Worker processes; 0 is one for every core. Does not affect results."""
    chunk_size: Annotated[int, Ge(0), Execution()] = 0
    """Policies that a worker or a device runs in lockstep; 0 is automatic. Does not affect results on the CPU."""
    device: Annotated[str, Choices(("cpu", *DEVICES)), Execution(), Shown(everyday=True)] = "cpu"
    """Device of the physics: cpu, cuda (an NVIDIA GPU; extra gpu) or warp-cpu (extra warp; for tests)."""
    nconmax: Annotated[int, Ge(1), Execution(), Needs("device", DEVICES)] | None = None
    """Contact buffer of a device, per simulation on average; by default chosen for the environment's model."""
    njmax: Annotated[int, Ge(1), Execution(), Needs("device", DEVICES)] | None = None
    """Constraint buffer of a device, in rows per simulation; by default chosen for the environment's model."""
    deterministic: Annotated[bool, Execution(), Needs("device", DEVICES)] = False
    """Whether a device repeats its results bit by bit; slower. Those of the CPU always repeat."""

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


@dataclass(frozen=True, init=False)
class TrainConfig:
    """The settings of a training run in sections: `config.run.seed`."""

    run: RunSettings
    workers: WorkerSettings
    environment: TaskOptions
    episodes: EpisodeSettings
    evaluation: EvaluationSettings
    sections: Mapping[str, Settings]
    """All sections by name, these and those of the algorithm."""
    values: Mapping[str, Any]
    """The values of all settings by name, options of registered classes included."""

    def __init__(self, sections: Mapping[str, Settings], values: Mapping[str, Any]) -> None:
        self.__dict__.update(sections, sections=sections, values=values)

    @classmethod
    def of(cls, **values: Any) -> TrainConfig:
        """Return the configuration with these settings: `TrainConfig.of(env="ant-gather", sigma=0.02)`."""
        known = check_names(values)
        checked = {name: each.checked(values.get(name, each.default)) for name, each in by_name(known).items()}
        sections = {name: own.of(checked) for name, own in sections_of(RunSettings.of(values)).items()}
        # A section may replace a value, such as a default that stands for another; options are in no field of it.
        own = {
            name: getattr(sections[section], name, checked[name]) for section, each in known.items() for name in each
        }
        config = cls(sections, own)
        if config.workers.device != "cpu" and find_environment(config.run.env).has_own_physics:
            raise ConfigError(
                f"device is {config.workers.device!r}, but {config.run.env} has physics of its own: it runs on the CPU "
                "alone. Set --device cpu."
            )
        config.algorithm.check(config)
        return config

    @classmethod
    def from_dict(cls, sections: Mapping[str, Mapping[str, Any]]) -> TrainConfig:
        """Return the configuration from the result of `to_dict`. A missing setting has its default."""
        return cls.of(**{name: value for own in sections.values() for name, value in own.items()})

    def having(self, **values: Any) -> TrainConfig:
        """Return a copy with other values of some settings."""
        return TrainConfig.of(**{**self.values, **values})

    def __getattr__(self, name: str) -> Any:
        sections = self.__dict__.get("sections", {})
        raise AttributeError(f"a run has no section of settings {name!r} here; it has {', '.join(sections)}")

    def __contains__(self, section: str) -> bool:
        return section in self.sections

    @property
    def settings(self) -> dict[str, Setting]:
        """The description of every setting by name, made anew: read it once for several."""
        return by_name(settings_by_section(self.run))

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the settings as JSON types, by section."""
        sections = settings_by_section(self.run).items()
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in self.values.items()}
        return {section: {name: plain[name] for name in settings} for section, settings in sections}

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a run, by name, as JSON types."""
        plain = {name: value for own in self.to_dict().values() for name, value in own.items()}
        found = {name: plain[name] for name, each in self.settings.items() if not each.has(Execution)}
        if robot := found.get("robot"):  # its path is no number: a run folder has a copy of the file
            try:
                found["robot"] = read_robot(robot).label
            except ConfigError:
                found["robot"] = robot_stem(robot)
        return found

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


_OF_EVERY_RUN: dict[str, type[Settings]] = {
    "run": RunSettings,
    "workers": WorkerSettings,
    "episodes": EpisodeSettings,
    "evaluation": EvaluationSettings,
}


def algorithm_of(run: RunSettings) -> type[Algorithm[Any]]:
    """Return the algorithm of a run; raise ConfigError if it sets goals where the environment does."""
    sets_goals = find_environment(run.env).task.sets_goals
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
    env, every = find_environment(run.env), _OF_EVERY_RUN
    body = {"body": env.body.Options} if isinstance(env, Environment) and env.body.Options is not Settings else {}
    own = {**algorithm_of(run).sections, "environment": env.task.Options, **body}
    return {"run": every["run"], "workers": every["workers"], **own, **every}


def settings_by_section(run: RunSettings) -> dict[str, dict[str, Setting]]:
    """Return the settings of a run by section and name."""
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
    environments = [*ENVIRONMENTS.values(), *ROBOT_ENVIRONMENTS.values()]
    own = (cls for env in environments for cls in (env.task.Options, env.body.Options))
    classes = dict.fromkeys((*own, ExternalOptions))
    sections = [_OF_EVERY_RUN, *({"": cls} for cls in classes), *(each.sections for each in algorithm_classes())]
    return {name: setting for each in sections for name, setting in by_name(with_options(each)).items()}


def resumable_settings() -> dict[str, Setting]:
    """Return the settings that `resume` takes, by name: those that do not change the numbers of a run."""
    execution = {name: each for name, each in by_name(with_options(_OF_EVERY_RUN)).items() if each.has(Execution)}
    return {name: each for name, each in execution.items() if name != "preset"}


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
            close = difflib.get_close_matches(name, here, n=1)
            hint = f"Did you mean {close[0]!r}?" if close else "`shes train ENV --help-all` lists the settings."
            raise ConfigError(f"unknown setting {name!r}. {hint}")
        raise ConfigError(
            f"{name} is not a setting of a run of {values['env']} with algorithm "
            f"{values.get('algorithm', RunSettings.algorithm)!r}, got {values[name]!r}. Omit {everywhere[name].flag}."
        )
    return sections
