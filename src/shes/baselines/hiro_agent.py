"""HIRO's agent: a controller sets a goal in the robot's own coordinates every c steps, and a primitive pursues it.

It acts by NumPy alone, so that a run can be evaluated and drawn without JAX. G coordinates of a goal.

Source: Nachum et al. 2018, section 3 and appendix C.1; its published code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shes.agents.agent import AgentBatch, AgentDesign
from shes.agents.mlp import MLP, RectifiedMLP
from shes.agents.views import ColumnsView
from shes.envs.episode_batch import EpisodeBatch
from shes.types import CONTROLLER, F32Array, F64Array


class HiroAgent(AgentBatch["HiroDesign"]):
    """HIRO's agents, in P lanes of R episodes each.

    The goal is stored as the coordinates that it leads to, s_t + g_t. Subtracting the current coordinates is the goal
    transition h(s, g, s') = s + g - s'.
    """

    def allocate(self) -> None:
        """Allocate the goals and the inputs of the primitive."""
        design, rows, xp = self.design, self.num_rows, self.xp
        self._limit = xp.asarray(design.half_range)
        self._target: F64Array = xp.zeros((rows, design.decision_size))
        self.goal = self._target[:, :2]
        self._inputs: F64Array = xp.zeros((rows, design.observation_sizes[-1]))
        self._view = design.primitive_view.on(xp)

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
        """Return the controls [N, A] of one step, after setting new goals where due; see `AgentBatch.act`."""
        design, size = self.design, self.design.decision_size
        coordinates = design.coordinates(observation, position)
        is_due = self.clock % design.controller_interval == 0
        if is_due.any():
            due = slice(None) if is_due.all() else np.flatnonzero(is_due)
            rows = self.rows(due)
            output = self.levels[CONTROLLER].act(observation[rows], decision_noise, rows, due)
            self._target[rows] = coordinates[rows] + output * self._limit
        self.clock += 1
        self._inputs[:, :size] = self._target - coordinates
        self._view.write(observation, heading, self._inputs[:, size:])
        return self.levels[-1].act(self._inputs, control_noise)


@dataclass(frozen=True, kw_only=True)
class HiroDesign(AgentDesign):
    """Design of HIRO's agent.

    A goal is the change of the first of the robot's own coordinates, relative to its current state. The primitive
    observes the goal, seen from the current state, and then its view.
    """

    agent = HiroAgent
    controller: RectifiedMLP
    primitive: RectifiedMLP
    primitive_view: ColumnsView
    half_range: tuple[float, ...]
    """Largest goal in each coordinate [G], in metres and radians."""
    columns: tuple[int, ...] | None
    """Indices of the coordinates in the observation; None for the position of an environment that observes none."""

    @classmethod
    def of(cls, task: EpisodeBatch, hidden: tuple[int, ...], goal_distance: float, **values: Any) -> HiroDesign:
        """Return the design of agents in `task`, with `values` of the other fields.

        Deviation: the primitive sees the robot without x and y, and the time; in HIRO x and y are zero.

        Raises:
            ConfigError: The robot's position is unknown.
        """
        task.check_position()
        half_range = (goal_distance, goal_distance, *(task.robot.goal_half_range if task.robot else ()))
        time = [i for i, name in enumerate(task.observation_names) if name == "time"]
        seen = [i for i in (*task.proprioception.tolist(), *time) if i not in task.position_columns]
        return cls(
            controller=RectifiedMLP(task.observation_size, hidden, len(half_range)),
            primitive=RectifiedMLP(len(half_range) + len(seen), hidden, task.action_size),
            primitive_view=ColumnsView(seen),
            half_range=half_range,
            columns=tuple(task.proprioception[: len(half_range)].tolist()) if task.robot else None,
            control_limit=task.control_limit,
            **values,
        )

    @property
    def networks(self) -> dict[str, MLP]:
        """The network of each level by name."""
        return {"controller": self.controller, "primitive": self.primitive}

    @property
    def controller_view(self) -> ColumnsView:
        """The view of the controller, which sees the whole observation."""
        return ColumnsView()

    @property
    def intrinsic_level(self) -> None:
        """None: a rollout does not compute the intrinsic reward, which depends on all coordinates of a goal."""
        return

    @property
    def decision_size(self) -> int:
        """Number of coordinates of a goal. Exploration noise is not added in a rollout, but where the agent learns."""
        return len(self.half_range)

    def coordinates(self, observation: F64Array, position: F64Array) -> F64Array:
        """Return the coordinates [N, G] of robots with these observations [N, O] and positions [N, 2], a copy."""
        return position.copy() if self.columns is None else observation[:, list(self.columns)]

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, G] for goals in directions `angles` [K] in the world; only x and y are to change."""
        outputs = np.zeros((len(angles), self.decision_size))
        outputs[:, 0], outputs[:, 1] = np.cos(angles), np.sin(angles)
        return outputs

    def exported(self) -> dict[str, Any]:
        """Return how often a goal is set, and the coordinates that it concerns."""
        goals = {"columns": self.columns, "half_range": self.half_range, "view": self.primitive_view.indices}
        return {"controller_interval": self.controller_interval, "state_goals": goals}
