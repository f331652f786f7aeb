"""One policy without goals: S-ES, the flat baseline of the SHES paper's figure 6.

Source: Salimans et al. 2017; algorithm specification section 4, last line.
"""

from __future__ import annotations

from dataclasses import dataclass

from shes.hierarchy.agent import AgentBatch, AgentDesign
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
    def intrinsic_level(self) -> None:
        """The environment pays."""
        return None

    @property
    def agent(self) -> type[FlatAgent]:
        """The class of its agents."""
        return FlatAgent


class FlatAgent(AgentBatch[FlatDesign]):
    """P lanes of R episodes each, of policies without goals. Rows [N] are lane after lane."""

    def allocate(self) -> None:
        """Make room for what the policies observe."""
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
        del position, heading, goal, decision_noise
        self._write_clock(self._inputs[:, : self._clock_size])
        self._inputs[:, self._clock_size :] = observation
        self.clock += 1
        return self._control(self._inputs, control_noise)
