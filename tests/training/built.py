"""What is built from the settings of a run, for tests of where they arrive."""

from dataclasses import dataclass
from typing import Any

from shes.algorithms.evolution.populations import Hyperparameters
from shes.algorithms.worker import WorkerPlan
from shes.es.level import TrainState
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.runs.config import TrainConfig
from shes.training.build import build_algorithm
from shes.training.presets import make_config

BRANCHED = {"primitive_estimate": "interval", "primitive_view": "egocentric"}
INTERVALS = {**BRANCHED, "population_size": 8, "sigma": 0.2, "learning_rate": 0.04, "horizon": 70}


@dataclass(frozen=True)
class Built:
    """Everything that is built from the settings of a run."""

    config: TrainConfig
    design: AgentDesign
    settings: Hyperparameters
    plan: WorkerPlan
    state: TrainState
    table: NoiseTable

    @classmethod
    def of(cls, env, **settings):
        config = make_config(env, "smoke", settings)
        made = build_algorithm(config)
        return cls(config, made.design, made.hyperparameters, made.plan(), made.start(config.run.seed), made.table)

    @property
    def intervals(self) -> Any:
        return self.settings.intervals

    @property
    def rules(self):
        return self.settings.updates

    def output_layers(self):
        """Tell of which levels the output layer is zero."""
        return [
            not level.theta[-(policy.sizes[-2] + 1) * policy.sizes[-1] :].any()
            for level, policy in zip(self.state.levels, self.design.policies, strict=True)
        ]
