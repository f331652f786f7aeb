"""TD3: twin critics, target policy smoothing, delayed updates of the actor. JAX and Optax.

The update is a pure function of the level's state, the transitions and the noise, so that it can be checked against any
other implementation. Networks are tuples of layers (weights [in, out], biases [out]).

B transitions, K updates in a call, O inputs, A outputs of the actor, D parameters of the actor.

Source: Fujimoto et al. 2018, Algorithm 1; the form of networks and losses is that of HIRO's code (Nachum et al. 2018).
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import optax

from shes.algorithms.hiro.levels import UpdateHyperparameters

Array: TypeAlias = jax.Array
Network: TypeAlias = tuple[tuple[Array, Array], ...]


class Learner(NamedTuple):
    """Networks of a level with their targets and the states of Adam. The critics are stacked on a first axis of two."""

    actor: Network
    critics: Network
    target_actor: Network
    target_critics: Network
    actor_optimizer: Any
    critic_optimizer: Any
    num_updates: Array


class Transitions(NamedTuple):
    """Transitions, or what they are made into for the update: axes are [K, B, ...], or [B, ...] for one update."""

    inputs: Array
    """Inputs of the networks before the step [B, O]."""
    action: Array
    """Output of the actor with its exploration noise [B, A], in units of the environment."""
    reward: Array
    discount: Array
    """Factor on the value of the next state [B]: 0 where there is none."""
    next_inputs: Array
    noise: Array
    """Standard normals [B, A], for the target actor."""


class Losses(NamedTuple):
    """Losses of one update, or of K updates [K]."""

    critic: Array
    actor: Array
    """NaN for an update that does not change the actor."""
    value: Array
    """Mean target of the critics."""


def act(actor: Network, inputs: Array, half_range: Array) -> Array:
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


def critic_targets(learner: Learner, batch: Transitions, own: UpdateHyperparameters) -> Array:
    """Return the targets of the critics [B]: r + discount * min(Q1', Q2') at the smoothed target action."""
    half_range, std, clip = (jnp.asarray(each) for each in (own.half_range, own.noise_std, own.noise_clip))
    noise = jnp.clip(batch.noise * std, -clip, clip)
    action = jnp.clip(act(learner.target_actor, batch.next_inputs, half_range) + noise, -half_range, half_range)
    return batch.reward + batch.discount * _values(learner.target_critics, batch.next_inputs, action).min(axis=0)


def critic_loss(critics: Network, batch: Transitions, target: Array, *, has_huber_loss: bool) -> Array:
    """Return the sum of both critics' mean losses."""
    error = _values(critics, batch.inputs, batch.action) - target
    each = optax.losses.huber_loss(error) if has_huber_loss else error * error
    return each.mean(axis=1).sum()


def actor_loss(actor: Network, critics: Network, inputs: Array, half_range: Array) -> Array:
    """Return minus the mean value that the first critic gives to the actor's actions."""
    first: Network = jax.tree.map(lambda stacked: stacked[0], critics)
    return -value(first, inputs, act(actor, inputs, half_range)).mean()


def update(own: UpdateHyperparameters, learner: Learner, batch: Transitions) -> tuple[Learner, Losses]:
    """Return the level after one update, and its losses."""
    actor_rule, critic_rule = optax.adam(own.actor_learning_rate), optax.adam(own.critic_learning_rate)
    target = critic_targets(learner, batch, own)
    loss, gradient = jax.value_and_grad(critic_loss)(learner.critics, batch, target, has_huber_loss=own.has_huber_loss)
    step, critic_optimizer = critic_rule.update(gradient, learner.critic_optimizer)
    critics = optax.apply_updates(learner.critics, step)
    learner = learner._replace(critics=critics, critic_optimizer=critic_optimizer, num_updates=learner.num_updates + 1)

    def delayed(learner: Learner) -> tuple[Learner, Array]:
        loss, gradient = jax.value_and_grad(actor_loss)(
            learner.actor, learner.critics, batch.inputs, jnp.asarray(own.half_range)
        )
        step, optimizer = actor_rule.update(gradient, learner.actor_optimizer)
        actor = optax.apply_updates(learner.actor, step)
        moved = partial(optax.incremental_update, step_size=own.target_rate)
        return learner._replace(
            actor=actor,
            actor_optimizer=optimizer,
            target_actor=moved(actor, learner.target_actor),
            target_critics=moved(learner.critics, learner.target_critics),
        ), loss

    is_due = learner.num_updates % own.policy_delay == 0
    learner, loss_of_actor = jax.lax.cond(is_due, delayed, lambda same: (same, jnp.float32(jnp.nan)), learner)
    return learner, Losses(loss, loss_of_actor, target.mean())


@cache
def compiled_update(own: UpdateHyperparameters) -> Any:
    """Return the compiled function `(learner, transitions) -> (learner, losses)` for K updates in sequence.

    The learner that it is given is consumed.
    """
    return jax.jit(lambda learner, batches: jax.lax.scan(partial(update, own), learner, batches), donate_argnums=0)
