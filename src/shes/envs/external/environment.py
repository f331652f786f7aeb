"""An external environment, as the rest of the package uses it: an `EnvironmentMaker`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shes.envs.external.description import ExternalDescription
from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.task import SimulatorFactory
from shes.errors import ConfigError
from shes.sim.cpu import CpuSimulator

if TYPE_CHECKING:
    from shes.envs.external.task import ExternalTask

__all__ = ["ExternalEnvironment"]


class ExternalEnvironment(ExternalDescription):
    """Makes episodes of an external environment. See `shes.register_external`."""

    sets_goals = False
    has_own_physics = True
    options = TaskOptions

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> ExternalTask:
        """Return `num_episodes` episodes.

        Raises:
            ConfigError: The device is not the CPU, the environment cannot be made or used, or an option has another
                value than its default; `reset_noise` and `evaluation`, which presets set, are ignored.
        """
        from shes.envs.external.task import ExternalTask  # imports Gymnasium

        if simulator is not CpuSimulator:
            raise ConfigError(f"{self.name} has its own physics, which runs on the CPU only. Set --device cpu.")
        for name, value in vars(TaskOptions()).items():
            if getattr(options or TaskOptions(), name) != value and name not in ("reset_noise", "evaluation"):
                raise ConfigError(f"{self.name} has no {name}. Omit --{name.replace('_', '-')}.")
        return ExternalTask(self, num_episodes)
