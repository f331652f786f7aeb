"""What is built from the settings of a run, for tests of where they arrive."""

from dataclasses import dataclass
from typing import Any

from shes.algorithms.evolution.populations import Settings
from shes.algorithms.worker import WorkerPlan
from shes.es.level import TrainState
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.runs.config import TrainConfig
from shes.training.build import build_design, build_plan, build_settings, build_state, open_noise_table
from shes.training.presets import make_config

BRANCHED = {"primitive_estimate": "interval", "primitive_view": "egocentric"}
INTERVALS = {**BRANCHED, "population_size": 8, "sigma": 0.2, "learning_rate": 0.04, "horizon": 70}


@dataclass(frozen=True)
class Built:
    """Everything that is built from the settings of a run."""

    config: TrainConfig
    design: AgentDesign
    settings: Settings
    plan: WorkerPlan
    state: TrainState
    table: NoiseTable

    @classmethod
    def of(cls, env, **settings):
        config = make_config(env, "smoke", settings)
        design = build_design(config)
        table = open_noise_table(config, design)
        plan = build_plan(config, design, table)
        return cls(config, design, build_settings(config), plan, build_state(config, design), table)

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
