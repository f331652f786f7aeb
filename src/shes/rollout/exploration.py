"""Noise and given decisions that are added to the outputs of the deciding level and to the controls.

In whole episodes of training it is exploration noise. In evaluations it is nothing, or decisions that are not learned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.agents.agent import AgentBatch
from shes.rollout.episodes import Decisions, EpisodeTask, Generation, wander
from shes.streams import EpisodePurpose, stream
from shes.types import F32Array, F64Array

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

    def begin(self, generation: Generation) -> None:
        """Start a generation. Evaluations and branches have no exploration noise."""
        explores = generation.kind == "training"
        self._decisions: Decisions | None = generation.decisions
        self._is_on = explores or self._decisions is not None
        self._has_control_noise = explores and not generation.has_frozen_control

    def draw(self, started: Mapping[int, tuple[int, EpisodeTask]]) -> None:
        """Draw the noise, and decisions if they are given, of tasks that have `started`, by lane, from their seeds."""
        if not self._is_on:
            return
        for lane, (_, task) in started.items():
            for slot, seed in zip(task.slots, task.seeds, strict=True):
                rng = stream(seed, EpisodePurpose.EXPLORATION_NOISE)
                for noise in self._drawn:
                    drawn = rng.standard_normal((noise.shape[0], noise.shape[3]), dtype=np.float32)
                    np.multiply(drawn, np.float32(EXPLORATION_STD), out=noise[:, lane, slot])
                if self._decisions is not None:
                    self._drawn[0][:, lane, slot] = self._decide(self._decisions, seed)
        self._decision_noise, self._control_noise = (self._agent.xp.asarray(noise) for noise in self._drawn)

    def _decide(self, decisions: Decisions, seed: int) -> F64Array:
        """Return the outputs [decisions, decision_size] of the deciding level in an episode."""
        count, design = len(self._drawn[0]), self._agent.design
        if decisions == "zero":
            return np.zeros((count, design.decision_size))
        if decisions == "random":
            angles = stream(seed, EpisodePurpose.RANDOM_GOALS).uniform(0, 2 * np.pi, count)
        elif decisions == "wander":
            angles = wander(stream(seed, EpisodePurpose.WANDERING), count, 1)[:, 0]
        else:
            angles = np.full(count, decisions)
        return design.direction_outputs(angles)

    def of_step(self) -> dict[str, F32Array]:
        """Return the noise of this step by argument of `act`; empty if the noise is off."""
        if not self._is_on:
            return {}
        design, steps = self._agent.design, np.minimum(self._agent.clock, self._horizon - 1)
        is_same = (steps == steps[0]).all()  # as usual: the noise is a view then
        noise, lanes = dict[str, F32Array](), np.arange(len(steps))
        if design.decision_size:
            places = steps // design.controller_interval
            noise["decision_noise"] = self._decision_noise[places[0] if is_same else (places, lanes)]
        if self._has_control_noise:
            noise["control_noise"] = self._control_noise[steps[0] if is_same else (steps, lanes)]
        return noise
