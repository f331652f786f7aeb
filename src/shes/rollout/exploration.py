"""Noise and given decisions that are added to the outputs of the deciding level and to the controls.

In whole episodes of training it is exploration noise. In evaluations it is nothing, or decisions that are not learned.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shes.agents.agent import AgentBatch
from shes.rollout.episodes import Decisions, EpisodeTask, Generation, wander
from shes.streams import EpisodePurpose, episode_stream
from shes.types import F32Array, F64Array, IntArray

EXPLORATION_STD = 0.01
"""Standard deviation of the exploration noise on the controller's output and on the control (authors' code)."""


class Exploration:
    """Exploration noise of an agent's episodes. It is drawn when they start, and transferred to the device at once."""

    def __init__(self, agent: AgentBatch[Any], horizon: int, action_size: int) -> None:
        self._agent, self._horizon = agent, horizon
        decisions = -(-horizon // agent.design.controller_interval)
        shapes = ((decisions, agent.design.decision_size), (horizon, action_size))
        self._drawn: list[F32Array] = [
            np.zeros((steps, agent.num_lanes, agent.rows_per_lane, size), np.float32) for steps, size in shapes
        ]
        self._decision_noise, self._control_noise = self._drawn  # on a device, copies
        self.is_on = False
        """Whether anything is added in this generation."""
        self._decisions: Decisions | None = None
        self._has_control_noise = False

    def begin(self, generation: Generation) -> None:
        """Start a generation. Evaluations and branches have no exploration noise."""
        explores = not generation.is_evaluation and not generation.branch_steps
        self._decisions = generation.decisions
        self.is_on = explores or self._decisions is not None
        self._has_control_noise = explores and not generation.has_frozen_control

    def draw(self, lane: int, task: EpisodeTask) -> None:
        """Draw the noise, and the decisions if they are given, of the episodes of `task` in `lane`, by their seeds."""
        for slot, seed in zip(task.slots, task.seeds, strict=True):
            rng = episode_stream(seed, EpisodePurpose.EXPLORATION_NOISE)
            for noise in self._drawn:
                drawn = rng.standard_normal((noise.shape[0], noise.shape[3]), dtype=np.float32)
                np.multiply(drawn, np.float32(EXPLORATION_STD), out=noise[:, lane, slot])
            if self._decisions is not None:
                self._drawn[0][:, lane, slot] = self._decide(self._decisions, seed)

    def _decide(self, decisions: Decisions, seed: int) -> F64Array:
        """Return the outputs [decisions, decision_size] of the deciding level in an episode."""
        count, design = len(self._drawn[0]), self._agent.design
        if decisions == "zero":
            return np.zeros((count, design.decision_size))
        if decisions == "random":
            rng = episode_stream(seed, EpisodePurpose.RANDOM_GOALS)
            return design.direction_outputs(rng.uniform(0, 2 * np.pi, count))
        if decisions == "wander":
            rng = episode_stream(seed, EpisodePurpose.WANDERING)
            return design.direction_outputs(wander(rng, count, 1)[:, 0])
        return design.direction_outputs(np.full(count, decisions))

    def upload(self) -> None:
        """Transfer the drawn noise to the agent's device."""
        self._decision_noise, self._control_noise = (self._agent.xp.asarray(noise) for noise in self._drawn)

    def of_step(self) -> dict[str, F32Array]:
        """Return the noise of this step by argument of `act`; empty if the noise is off."""
        if not self.is_on:
            return {}
        clock, last = self._agent.clock, self._horizon - 1
        first = int(clock[0])
        # All lanes are usually at the same step. The noise is a view then.
        step = min(first, last) if (clock == first).all() else np.minimum(clock, last)
        noise: dict[str, F32Array] = {}
        design = self._agent.design
        if design.decision_size:
            noise["decision_noise"] = _at(self._decision_noise, step // design.controller_interval)
        if self._has_control_noise:
            noise["control_noise"] = _at(self._control_noise, step)
        return noise


def _at(noise: F32Array, place: int | IntArray) -> F32Array:
    """Return `noise[place[p], p]` [P, ...] for each lane p; a view if all lanes have the same place."""
    return noise[place] if isinstance(place, int) else noise[place, np.arange(len(place))]
