"""Exploration noise on the outputs of the deciding level and on the controls, in whole episodes of training."""

from __future__ import annotations

from typing import Any

import numpy as np

from shes.hierarchy.agent import AgentBatch
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.types import F32Array, IntArray

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
        """Whether this generation has exploration noise."""
        self._has_frozen_control = False

    def begin(self, generation: Generation) -> None:
        """Start a generation. Evaluations and branches have no exploration noise."""
        self.is_on = not generation.is_evaluation and not generation.branch_steps
        self._has_frozen_control = generation.has_frozen_control

    def draw(self, lane: int, task: EpisodeTask) -> None:
        """Draw the noise of the episodes of `task` in `lane`, each from its own seed."""
        for slot, seed in zip(task.slots, task.seeds, strict=True):
            rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(1,))))
            for noise in self._drawn:
                drawn = rng.standard_normal((noise.shape[0], noise.shape[3]), dtype=np.float32)
                np.multiply(drawn, np.float32(EXPLORATION_STD), out=noise[:, lane, slot])

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
        if not self._has_frozen_control:
            noise["control_noise"] = _at(self._control_noise, step)
        return noise


def _at(noise: F32Array, place: int | IntArray) -> F32Array:
    """Return `noise[place[p], p]` [P, ...] for each lane p; a view if all lanes have the same place."""
    return noise[place] if isinstance(place, int) else noise[place, np.arange(len(place))]
