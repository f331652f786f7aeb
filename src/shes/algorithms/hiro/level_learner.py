"""The learner of a level during a generation: its networks in JAX, its transitions drawn from the replay buffer.

A level's networks are tuples of layers here, and flat vectors between generations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import optax

from shes.algorithms.hiro.correction import relabelled
from shes.algorithms.hiro.goal_space import candidates
from shes.algorithms.hiro.levels import LearnerState, Level
from shes.algorithms.hiro.replay import Rows
from shes.algorithms.hiro.td3 import Learner, Losses, Network, Transitions, compiled_update
from shes.es.level import LevelParameters
from shes.es.statistics import normalise
from shes.types import F32Array

_Shapes = tuple[tuple[int, int], ...]


class LevelLearner:
    """Learns one level from its replay buffer."""

    def __init__(self, level: Level, state: LearnerState, discount: float, batch_size: int, clip: float) -> None:
        """Begin with `state`. Normalised inputs are clipped to plus and minus `clip`."""
        self.level, self._state = level, state
        self._discount, self._batch_size, self._clip = discount, batch_size, clip
        self.replay = state.replay
        self._statistics = self._observed = state.statistics
        self.learner = to_learner(level, state)
        self._update = compiled_update(level.hyperparameters)
        self._losses: list[Losses] = []

    @property
    def parameters(self) -> LevelParameters:
        """Parameters of the current actor, with the normalisation of the generation."""
        return LevelParameters.of(flat(self.learner.actor), self._statistics)

    @property
    def num_updates(self) -> int:
        """Number of updates of the critics."""
        return int(self.learner.num_updates)

    @property
    def can_learn(self) -> bool:
        """Whether the buffer holds a batch."""
        return self.replay.size >= self._batch_size

    def add(self, rows: Rows) -> None:
        """Store new transitions, and their inputs for the statistics of the next generation."""
        inputs = rows["inputs"].astype(np.float64)
        if len(inputs):
            self.replay = self.replay.append(rows)
            self._observed = self._observed.merge(len(inputs), inputs.sum(axis=0), (inputs * inputs).sum(axis=0))

    def update(self, count: int, rng: np.random.Generator) -> None:
        """Make `count` updates."""
        rows = self.draw(count, rng)
        inputs, next_inputs = (self._normalised(rows[name]) for name in ("inputs", "next_inputs"))
        batches = Transitions(
            inputs=inputs,
            action=rows["action"],
            reward=rows["reward"],
            discount=rows["goes_on"] * np.float32(self._discount),
            next_inputs=next_inputs,
            noise=rng.standard_normal(rows["action"].shape, dtype=np.float32),
        )
        self.learner, losses = self._update(self.learner, batches)
        self._losses.append(losses)

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, F32Array]:
        """Return `count` batches of transitions [K, B, ...]."""
        return self.replay.sample(rng, count, self._batch_size)

    def finish(self, *, normalises: bool) -> tuple[LearnerState, dict[str, float]]:
        """Return the state of the level after the generation, and the means of the losses by name.

        With `normalises`, the statistics include the inputs of this generation from now on.
        """
        losses = [np.concatenate([np.asarray(each[i]) for each in self._losses] or [[np.nan]]) for i in range(3)]
        made = losses[1][np.isfinite(losses[1])]
        means = {
            "critic_loss": float(losses[0].mean()),
            "actor_loss": float(made.mean()) if len(made) else np.nan,
            "value": float(losses[2].mean()),
        }
        state = replace(
            self._state,
            learner=to_arrays(self.learner),
            num_updates=self.num_updates,
            statistics=self._observed if normalises else self._statistics,
            replay=self.replay,
        )
        return state, means

    def _normalised(self, inputs: F32Array) -> F32Array:
        return normalise(inputs, *self.normalisation, self._clip)

    @property
    def normalisation(self) -> tuple[Any, Any]:
        """Mean and inverse standard deviation of the inputs [O]."""
        return self._statistics.mean, 1 / self._statistics.std


class ControllerLearner(LevelLearner):
    """Learns the controller, with the off-policy correction by the current primitive."""

    def __init__(
        self,
        level: Level,
        state: LearnerState,
        discount: float,
        batch_size: int,
        clip: float,
        primitive: LevelLearner,
        num_candidates: int,
    ) -> None:
        """See `LevelLearner`; the goals are corrected by `primitive`, each among `num_candidates`."""
        super().__init__(level, state, discount, batch_size, clip)
        self._primitive, self._num_candidates = primitive, num_candidates

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, F32Array]:
        """Return `count` batches of transitions [K, B, ...], with corrected goals as actions."""
        rows = self.replay.sample(rng, count * self._batch_size)
        limits = self.level.hyperparameters.half_range
        goals = candidates(rows["goal"], rows["change"], limits, self._num_candidates, rng).astype(np.float32)
        rows["action"] = goals[:, 0] if self._num_candidates == 1 else np.asarray(self._corrected(rows, goals))
        used = ("inputs", "action", "reward", "goes_on", "next_inputs")
        return {name: rows[name].reshape(count, self._batch_size, *rows[name].shape[1:]) for name in used}

    def _corrected(self, rows: dict[str, F32Array], goals: F32Array) -> Any:
        mean, inverse_std = self._primitive.normalisation
        size = goals.shape[-1]
        limit = np.asarray(self._primitive.level.hyperparameters.half_range, np.float32)
        return relabelled(
            self._primitive.learner.actor,
            goals,
            rows["moved"],
            normalise(rows["view"], mean[size:], inverse_std[size:], self._clip),
            rows["actions"] / limit,
            rows["is_step"],
            mean[:size].astype(np.float32),
            inverse_std[:size].astype(np.float32),
            np.float32(self._clip),
        )


def flat(network: Network) -> F32Array:
    """Return the parameters of a network [..., D], layer by layer."""
    parts = [np.asarray(array) for layer in network for array in layer]
    lead = parts[-1].shape[:-1]
    return np.concatenate([part.reshape(*lead, -1) for part in parts], axis=-1)


def network(parameters: F32Array, shapes: _Shapes) -> Network:
    """Return the layers of the flat `parameters` [..., D]."""
    layers, start, lead = [], 0, parameters.shape[:-1]
    for fan_in, fan_out in shapes:
        middle, end = start + fan_in * fan_out, start + (fan_in + 1) * fan_out
        weights = parameters[..., start:middle].reshape(*lead, fan_in, fan_out)
        layers.append((jax.numpy.array(weights), jax.numpy.array(parameters[..., middle:end])))
        start = end
    return tuple(layers)


def to_learner(level: Level, state: LearnerState) -> Learner:
    """Return the networks and optimizers of `state`. Nothing is shared with it, because updates consume them."""
    shapes = {"actor": level.actor_shapes, "critics": level.critic_shapes}
    made = {name: network(array, shapes[name.rpartition("_")[2]]) for name, array in state.learner.items()}
    counts = {"actor": state.num_updates // level.hyperparameters.policy_delay, "critics": state.num_updates}
    adam = {
        name: optax.ScaleByAdamState(jax.numpy.int32(count), made[f"mean_{name}"], made[f"square_{name}"])
        for name, count in counts.items()
    }
    return Learner(
        actor=made["actor"],
        critics=made["critics"],
        target_actor=made["target_actor"],
        target_critics=made["target_critics"],
        actor_optimizer=(adam["actor"], optax.EmptyState()),
        critic_optimizer=(adam["critics"], optax.EmptyState()),
        num_updates=jax.numpy.int32(state.num_updates),
    )


def to_arrays(learner: Learner) -> dict[str, F32Array]:
    """Return the flat parameters and moments of `learner` by name."""
    optimizers = {"actor": learner.actor_optimizer[0], "critics": learner.critic_optimizer[0]}
    return {
        "actor": flat(learner.actor),
        "critics": flat(learner.critics),
        "target_actor": flat(learner.target_actor),
        "target_critics": flat(learner.target_critics),
        **{f"mean_{name}": flat(each.mu) for name, each in optimizers.items()},
        **{f"square_{name}": flat(each.nu) for name, each in optimizers.items()},
    }
