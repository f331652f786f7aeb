"""A single policy without goals: S-ES, the flat baseline of the SHES paper's figure 6.

Source: Salimans et al. 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from shes.hierarchy.agent import AgentBatch, AgentDesign
from shes.policies.mlp import MLP
from shes.types import F32Array, F64Array


@dataclass(frozen=True, kw_only=True)
class FlatDesign(AgentDesign):
    """Design of a flat agent. The policy observes the clock, then the observation of the task."""

    level_names: ClassVar[tuple[str, ...]] = ("policy",)
    policy: MLP

    @property
    def agent(self) -> type[FlatAgent]:
        """The class of the agents."""
        return FlatAgent


class FlatAgent(AgentBatch[FlatDesign]):
    """Policies without goals, in P lanes of R episodes each."""

    def allocate(self) -> None:
        """Allocate the inputs of the policies."""
        self._clock_size = self.design.clock_size
        self._inputs: F64Array = self.xp.zeros((self.num_rows, self.design.observation_sizes[0]))

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
        """Return the controls [N, A] of one step; see `AgentBatch.act`."""
        self._write_clock(self._inputs[:, : self._clock_size])
        self._inputs[:, self._clock_size :] = observation
        self.clock += 1
        return self._control(self._inputs, control_noise)
