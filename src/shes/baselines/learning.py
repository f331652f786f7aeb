"""Learning with JAX and Optax: the update of TD3, the learner of a level, and HIRO's off-policy correction.

The update is a pure function of networks, transitions and noise, so that it can be checked against any other
implementation. The correction asks which goal explains the actions of an old interval to the primitive of today.

B transitions or intervals of c steps, K updates in a call, O inputs, A outputs of the actor, J candidates, V values of
the primitive's view, G coordinates of a goal.

Source: Fujimoto et al. 2018, Algorithm 1; Nachum et al. 2018 (HIRO), section 3.3. The form of networks and losses, and
the measure of the correction, are those of HIRO's code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import optax

from shes.agents.mlp import normalise
from shes.baselines.learner_settings import LearnerSettings
from shes.baselines.levels import Learner, LearnerState, Level, Network, Rows
from shes.errors import ConfigError, DivergenceError
from shes.types import F32Array, FloatArray

TARGET_NOISE, TARGET_NOISE_CLIP = 0.2, 0.5
"""Standard deviation and limit of the noise on the target actor's outputs, in the unit of `--noise-unit`."""
NUM_CANDIDATES = 10
"""Goals among which the correction chooses."""

Array: TypeAlias = jax.Array
Batch: TypeAlias = Mapping[str, Any]
"""Transitions [B, ...], or [K, B, ...] for K updates: `inputs` and `next_inputs` of the networks [O]; `action` [A], in
units of the environment; `reward`; `goes_on`, 0 where the next state has no value; `noise` [A], standard normals."""
LOSSES = ("critic_loss", "actor_loss", "value")
"""Losses of an update; NaN for an actor that it does not change. `value` is the mean target of the critics."""


def check_device() -> None:
    """Raise ConfigError if JAX finds no device."""
    try:
        jax.devices()
    except RuntimeError as error:
        raise ConfigError(f"JAX cannot compute here: {error}. Unset JAX_PLATFORMS, or set it to cpu.") from error


@contextmanager
def plain_settings() -> Iterator[None]:
    """Use JAX's default types and broadcasting in the block, whatever a script or the environment has set."""
    with jax.enable_x64(False), jax.numpy_rank_promotion("allow"):
        yield


def act(actor: Network, inputs: Array, half_range: Any) -> Array:
    """Return the actions [..., A] of an actor for its inputs [..., O]."""
    layer = inputs
    for weights, biases in actor[:-1]:
        layer = jax.nn.relu(layer @ weights + biases)
    weights, biases = actor[-1]
    return jnp.tanh(layer @ weights + biases) * half_range


def value(critic: Network, inputs: Array, action: Array) -> Array:
    """Return the values [B] of actions. The action is an input of every hidden layer."""
    layer = inputs
    for weights, biases in critic[:-1]:
        layer = jax.nn.relu(jnp.concatenate([layer, action], axis=-1) @ weights + biases)
    weights, biases = critic[-1]
    return (layer @ weights + biases)[..., 0]


_values = jax.vmap(value, in_axes=(0, None, None))  # of both critics [2, B]


def update(
    settings: LearnerSettings, half_range: tuple[float, ...], learner: Learner, batch: Batch
) -> tuple[Learner, dict[str, Array]]:
    """Return the learner after one update, and the losses. `half_range` is that of the actor's outputs [A]."""
    limit, unit = np.array(half_range, np.float32), settings.noise_units(half_range)
    std, clip = ((unit * size).astype(np.float32) for size in (TARGET_NOISE, TARGET_NOISE_CLIP))

    def critic_loss(critics: Network) -> Array:
        error = _values(critics, batch["inputs"], batch["action"]) - targets
        return optax.losses.huber_loss(error).mean(axis=1).sum()

    def actor_loss(actor: Network, critics: Network) -> Array:
        first = jax.tree.map(lambda stacked: stacked[0], critics)
        return -value(first, batch["inputs"], act(actor, batch["inputs"], limit)).mean()

    def delayed(learner: Learner) -> tuple[Learner, Array]:
        loss, gradient = jax.value_and_grad(actor_loss)(learner["actor"], learner["critics"])
        count = learner["num_updates"] // settings.policy_delay - 1
        learner = _stepped(learner, "actor", gradient, settings.actor_learning_rate, count)
        moved = partial(optax.incremental_update, step_size=settings.target_rate)
        targets = {f"target_{name}": moved(learner[name], learner[f"target_{name}"]) for name in ("actor", "critics")}
        return {**learner, **targets}, loss

    # r + discount * min(Q1', Q2') at the smoothed target action
    noise = jnp.clip(batch["noise"] * std, -clip, clip)
    action = jnp.clip(act(learner["target_actor"], batch["next_inputs"], limit) + noise, -limit, limit)
    values = _values(learner["target_critics"], batch["next_inputs"], action).min(axis=0)
    targets = batch["reward"] + settings.discount * batch["goes_on"] * values
    loss, gradient = jax.value_and_grad(critic_loss)(learner["critics"])
    learner = _stepped(learner, "critics", gradient, settings.critic_learning_rate, learner["num_updates"])
    learner = {**learner, "num_updates": learner["num_updates"] + 1}
    is_due = learner["num_updates"] % settings.policy_delay == 0
    learner, loss_of_actor = jax.lax.cond(is_due, delayed, lambda same: (same, jnp.float32(jnp.nan)), learner)
    return learner, dict(zip(LOSSES, (loss, loss_of_actor, targets.mean()), strict=True))


def _stepped(learner: Learner, name: str, gradient: Network, rate: float, count: Array) -> Learner:
    """Return `learner` after a step of Adam of its networks `name`, the step with number `count`."""
    moments = optax.ScaleByAdamState(count, learner[f"mean_{name}"], learner[f"square_{name}"])
    step, (moments, _) = optax.adam(rate).update(gradient, (moments, optax.EmptyState()))
    network = optax.apply_updates(learner[name], step)
    return {**learner, name: network, f"mean_{name}": moments.mu, f"square_{name}": moments.nu}


@cache
def compiled_update(settings: LearnerSettings, half_range: tuple[float, ...]) -> Any:
    """Return the compiled function `(learner, batches) -> (learner, losses)` for K updates in sequence.

    The learner that it is given is consumed.
    """
    one = partial(update, settings, half_range)
    return jax.jit(lambda learner, batches: jax.lax.scan(one, learner, batches), donate_argnums=0)


def make_learners(levels: Sequence[Level], states: Sequence[LearnerState]) -> dict[str, LevelLearner]:
    """Return the learner of each level by name. The level that acts every step comes last."""
    *upper, lower = zip(levels, states, strict=True)
    acting = LevelLearner(*lower)
    learners = [*(ControllerLearner(level, state, acting) for level, state in upper), acting]
    return {learner.level.name: learner for learner in learners}


class LevelLearner:
    """Learns one level from its replay buffer during a generation."""

    def __init__(self, level: Level, state: LearnerState) -> None:
        self.level, self.settings, self.replay = level, level.settings, state.replay
        self.statistics = self._observed = state.statistics
        self.learner = jax.tree.map(jnp.array, state.learner)  # a copy, because updates consume it
        self._losses: list[Mapping[str, Array]] = []

    @property
    def actor(self) -> Network:
        """Network of the current actor: arrays of NumPy."""
        return jax.tree.map(np.array, self.learner["actor"])

    def add(self, rows: Rows) -> None:
        """Store new transitions, and their inputs for the statistics of the next generation."""
        inputs = rows["inputs"].astype(np.float64)
        if len(inputs):
            self.replay = self.replay.append(rows)
            self._observed = self._observed.merge(len(inputs), inputs.sum(axis=0), (inputs * inputs).sum(axis=0))

    def update(self, count: int, rng: np.random.Generator) -> None:
        """Make `count` updates if the buffer holds a batch; raise DivergenceError if the actor is not finite."""
        if self.replay.size < self.settings.batch_size:
            return
        rows = self.draw(count, rng)
        rows |= {name: self.normalised(rows[name]) for name in ("inputs", "next_inputs")}
        rows["noise"] = rng.standard_normal(rows["action"].shape, dtype=np.float32)
        self.learner, losses = compiled_update(self.settings, self.level.half_range)(self.learner, rows)
        self._losses.append(losses)
        self._check_finite(self.actor)

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, F32Array]:
        """Return `count` batches of transitions [K, B, ...]."""
        return self.replay.sample(rng, count, self.settings.batch_size)

    def normalised(self, inputs: F32Array, place: slice = slice(None)) -> F32Array:
        """Return `inputs` [..., O], or those of its columns that are at `place`, as the networks see them."""
        mean, std = self.statistics.mean[place], self.statistics.std[place]
        return normalise(inputs, mean, 1 / std, self.settings.input_clip)

    def finish(self) -> tuple[LearnerState, dict[str, float]]:
        """Return the state of the level after the generation, and the means of the losses; NaN without an update.

        If inputs are normalised, the statistics include those of this generation from now on. Raise DivergenceError
        if a loss or a parameter is NaN or infinite.
        """
        learner = jax.tree.map(np.array, self.learner)
        none = np.zeros(0, np.float32)
        losses = {name: np.concatenate([none, *(each[name] for each in self._losses)]) for name in LOSSES}
        self._check_finite((learner, losses["critic_loss"]))
        losses["actor_loss"] = losses["actor_loss"][np.isfinite(losses["actor_loss"])]
        state = LearnerState(
            learner={**learner, "num_updates": int(learner["num_updates"])},
            statistics=self._observed if self.settings.normalise_inputs else self.statistics,
            replay=self.replay,
        )
        return state, {name: float(each.mean()) if len(each) else np.nan for name, each in losses.items()}

    def _check_finite(self, arrays: Any) -> None:
        if not all(np.isfinite(array).all() for array in jax.tree.leaves(arrays)):
            raise DivergenceError(
                f"the networks of the {self.level.name} have diverged after {int(self.learner['num_updates']):,} "
                "updates (NaN or infinity). Everything up to the last checkpoint is kept. Start another run with a "
                "lower --critic-learning-rate, --actor-learning-rate or --reward-scale."
            )


class ControllerLearner(LevelLearner):
    """Learns the controller, with the off-policy correction by the current primitive."""

    def __init__(self, level: Level, state: LearnerState, primitive: LevelLearner) -> None:
        """See `LevelLearner`; the goals are corrected by `primitive`."""
        super().__init__(level, state)
        self._primitive = primitive

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, F32Array]:
        """Return `count` batches of transitions [K, B, ...], with corrected goals as actions."""
        batch, primitive, size = self.settings.batch_size, self._primitive, len(self.level.half_range)
        rows = self.replay.sample(rng, count * batch)
        goals = candidates(rows["goal"], rows["change"], self.level.half_range, rng).astype(np.float32)
        played = {
            "moved": rows["moved"],
            "view": primitive.normalised(rows["view"], slice(size, None)),
            "actions": rows["actions"] / np.array(primitive.level.half_range, np.float32),
            "is_step": rows["is_step"],
        }
        mean, std = (own[:size] for own in (primitive.statistics.mean, primitive.statistics.std))
        moments = mean.astype(np.float32), (1 / std).astype(np.float32), np.float32(self.settings.input_clip)
        errors = np.asarray(correction_errors(primitive.learner["actor"], goals, played, *moments))
        rows["action"] = goals[np.arange(len(goals)), errors.argmin(axis=1)]
        used = ("inputs", "action", "reward", "goes_on", "next_inputs")
        return {name: rows[name].reshape(count, batch, *rows[name].shape[1:]) for name in used}


@jax.jit
def correction_errors(
    primitive: Network, goals: Array, intervals: Mapping[str, Array], mean: Array, inverse_std: Array, clip: Array
) -> Array:
    """Return how badly each candidate explains the actions [B, J]: the summed squared error, in control limits.

    Args:
        primitive: The actor of the primitive.
        goals: Candidates [B, J, G] at the start of each interval.
        intervals: Of each step: `moved`, the change of the coordinates since the start [B, c, G]; `view`, as the
            network sees it [B, c, V]; `actions`, in control limits [B, c, A]; `is_step`, 0 if a fall cut it off [B, c].
        mean: Mean of goals by which the network's inputs are normalised [G].
        inverse_std: Inverse of their standard deviation [G].
        clip: Largest absolute value of a normalised input.
    """
    rolled = goals[:, :, None] - intervals["moved"][:, None]  # the goal transition, from the start of the interval
    scaled = jnp.clip((rolled - mean) * inverse_std, -clip, clip)
    seen = jnp.broadcast_to(intervals["view"][:, None], (*rolled.shape[:-1], intervals["view"].shape[-1]))
    error = act(primitive, jnp.concatenate([scaled, seen], axis=-1), 1) - intervals["actions"][:, None]
    return ((error * error).sum(axis=-1) * intervals["is_step"][:, None]).sum(axis=-1)


def candidates(
    goal: FloatArray, moved: FloatArray, half_range: Sequence[float], rng: np.random.Generator
) -> FloatArray:
    """Return the goals [B, J, G] among which the off-policy correction chooses.

    The first is the original `goal` [B, G], the second the change of the coordinates `moved` [B, G] in the interval.
    The others are drawn around that change, with half the half range as standard deviation. All are clipped to the
    range.
    """
    limit = np.asarray(half_range)
    noise = rng.standard_normal((len(goal), NUM_CANDIDATES - 2, len(limit)))
    found = [goal[:, None], moved[:, None], moved[:, None] + noise * (0.5 * limit)]
    return np.clip(np.concatenate(found, axis=1), -limit, limit)
