"""HIRO's off-policy correction: which goal explains the actions of an old interval to the primitive of today. JAX.

B intervals of c steps, J candidates, V values of the primitive's view, G coordinates of a goal, A controls.

Source: Nachum et al. 2018, section 3.3; the measure is that of its published code, which is proportional to the paper's
log probability.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from shes.algorithms.hiro.td3 import Array, Network, act


def errors(  # noqa: PLR0917 - the terms of a formula
    primitive: Network,
    goals: Array,
    moved: Array,
    view: Array,
    actions: Array,
    is_step: Array,
    goal_mean: Array,
    goal_inverse_std: Array,
    clip: float,
) -> Array:
    """Return how badly each candidate explains the actions [B, J]: the summed squared error, in control limits.

    Args:
        primitive: The actor of the primitive.
        goals: Candidates [B, J, G] at the start of each interval.
        moved: Change of the coordinates from the start of the interval to each of its steps [B, c, G].
        view: The primitive's view at each step, as the network sees it [B, c, V].
        actions: Its actions [B, c, A], in control limits.
        is_step: 1 for steps of the interval [B, c], 0 for those that a fall cut off.
        goal_mean: Mean of goals by which the network's inputs are normalised [G].
        goal_inverse_std: Inverse of their standard deviation [G].
        clip: Largest absolute value of a normalised input.
    """
    rolled = goals[:, :, None] - moved[:, None]  # the goal transition, from the start of the interval
    scaled = jnp.clip((rolled - goal_mean) * goal_inverse_std, -clip, clip)
    seen = jnp.broadcast_to(view[:, None], (*rolled.shape[:-1], view.shape[-1]))
    error = act(primitive, jnp.concatenate([scaled, seen], axis=-1), jnp.float32(1)) - actions[:, None]
    return ((error * error).sum(axis=-1) * is_step[:, None]).sum(axis=-1)


@jax.jit
def relabelled(primitive: Network, goals: Array, *interval: Array) -> Array:
    """Return the candidate [B, G] with the least error; for the arguments see `errors`."""
    best = errors(primitive, goals, *interval).argmin(axis=1)
    return jnp.take_along_axis(goals, best[:, None, None], axis=1)[:, 0]
