"""One policy without goals: S-ES, the flat baseline of the SHES paper's figure 6.

Source: Salimans et al. 2017; algorithm specification section 4, last line.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from shes.hierarchy.agent import Agent, AgentDesign
from shes.policies.mlp import MLP
from shes.types import F32Array, F64Array

__all__ = ["FlatAgent", "FlatDesign"]


@dataclass(frozen=True, kw_only=True)
class FlatDesign(AgentDesign):
    """What a flat agent is made of. The policy observes the clock, then what the environment shows."""

    policy: MLP

    @property
    def level_names(self) -> tuple[str, ...]:
        """The policy."""
        return ("policy",)

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The network."""
        return (self.policy,)

    @property
    def internal_level(self) -> None:
        """The environment pays."""
        return None

    def make(self, num_lanes: int, num_episodes: int, xp: ModuleType = np, *, shares_noise: bool = False) -> FlatAgent:
        """Return an agent of `num_lanes` lanes of `num_episodes` episodes; see `Agent`."""
        return FlatAgent(self, num_lanes, num_episodes, xp, shares_noise=shares_noise)


class FlatAgent(Agent):
    """P lanes of R episodes each, of policies without goals. Rows [N] are lane after lane."""

    def __init__(
        self,
        design: FlatDesign,
        num_lanes: int,
        num_episodes: int,
        xp: ModuleType = np,
        *,
        shares_noise: bool = False,
    ) -> None:
        """Make room for `num_lanes` lanes of `num_episodes` episodes; see `Agent`."""
        super().__init__(design, num_lanes, num_episodes, xp, shares_noise=shares_noise)
        self._clock_size = design.clock_size
        self._inputs: F64Array = xp.zeros((num_lanes * num_episodes, design.observation_sizes[0]))

    def act(
        self,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        *,
        goal: F64Array | None = None,
        decision_noise: F32Array | None = None,
        control_noise: F32Array | None = None,
    ) -> F32Array:
        """Return the controls [N, A] of one step; see `Agent.act`."""
        del position, heading, goal, decision_noise
        self._write_clock(self._inputs[:, : self._clock_size])
        self._inputs[:, self._clock_size :] = observation
        self.clock += 1
        return self._control(self._inputs, control_noise)
