"""Parts built from the settings of a run, for tests."""

from dataclasses import dataclass
from typing import Any

from shes.agents.agent import AgentDesign
from shes.evolution.estimates import Hyperparameters
from shes.rollout.worker import WorkerPlan
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config

INTERVALS = {
    "primitive_estimate": "interval",
    "primitive_view": "egocentric",
    "population_size": 8,
    "sigma": 0.2,
    "learning_rate": 0.04,
    "horizon": 70,
}


@dataclass(frozen=True)
class Built:
    """The agents' design, the hyperparameters and the workers' plan of a run."""

    design: AgentDesign
    settings: Hyperparameters
    plan: WorkerPlan

    @classmethod
    def of(cls, env, **settings):
        made = build_algorithm(make_config(env, "smoke", settings))
        return cls(made.design, made.hyperparameters, made.plan())

    @property
    def intervals(self) -> Any:
        return self.settings.intervals

    @property
    def rules(self):
        return self.settings.updates
