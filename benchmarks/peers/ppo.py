"""PPO in one file, over the vector environment of SHES, with the view of our own walker. Source: Schulman et al. 2017.

Details as in Huang et al. 2022 (37 implementation details): normalised observations, generalised advantages, clipped
objective, clipped gradients; the learning rate follows the divergence of the policy (Schulman et al. 2017, section 4).
At a time limit the value of the last state stands for the rest of the episode.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy

import numpy as np
import torch
from torch import nn
from walking import Act, OwnView, Walk

NUM_ENVS, STEPS, EPOCHS, MINIBATCHES = 256, 32, 5, 4
GAMMA, LAMBDA, CLIP, VALUE_WEIGHT, MAX_NORM = 0.98, 0.95, 0.2, 1.0, 1.0
LEARNING_RATE, TARGET_KL, START_STD = 1e-3, 0.01, 0.5
HIDDEN = 64


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a network with two hidden layers."""
    layers = nn.Sequential(
        nn.Linear(inputs, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, outputs)
    )
    for layer in layers:
        if isinstance(layer, nn.Linear):
            nn.init.orthogonal_(layer.weight, gain if layer.out_features == outputs else 2**0.5)
            nn.init.zeros_(layer.bias)
    return layers


class Policy(nn.Module):
    """Actor, critic, and the normalisation of their inputs."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.actor, self.critic = network(inputs, actions, 0.01), network(inputs, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), float(np.log(START_STD))))
        self.register_buffer("mean", torch.zeros(inputs, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(inputs, dtype=torch.float64))
        self.count = 1e-4

    def observe(self, inputs: np.ndarray) -> None:
        """Add inputs [N, I] to the statistics."""
        batch = torch.as_tensor(inputs)
        count, mean, variance = len(batch), batch.mean(0), batch.var(0, unbiased=False)
        total, difference = self.count + count, mean - self.mean
        self.mean += difference * count / total
        squares = self.variance * self.count + variance * count + difference**2 * self.count * count / total
        self.variance, self.count = squares / total, total

    def normalised(self, inputs: np.ndarray) -> torch.Tensor:
        """Return inputs with mean 0 and variance 1, clipped."""
        return ((torch.as_tensor(inputs) - self.mean) / (self.variance + 1e-8).sqrt()).clamp(-5, 5).float()

    def distribution(self, seen: torch.Tensor) -> torch.distributions.Normal:
        """Return the distribution of the actions."""
        return torch.distributions.Normal(self.actor(seen), self.log_std.exp().expand(len(seen), -1))


def act(walk: Walk, policy: Policy) -> Act:
    """Return the deterministic actions of a copy of `policy`, in new episodes."""
    view, kept = OwnView(walk, walk.episodes), deepcopy(policy)

    @torch.no_grad()
    def mean_action(inputs: np.ndarray) -> np.ndarray:
        return kept.actor(kept.normalised(inputs)).clamp(-1, 1).numpy()

    return lambda observation: view.act(observation, mean_action)


def advantages(reward: torch.Tensor, value: torch.Tensor, ended: torch.Tensor) -> torch.Tensor:
    """Return the generalised advantages [T, N] of T steps, given the values [T + 1, N]."""
    found, last = torch.zeros_like(reward), torch.zeros(reward.shape[1])
    for step in reversed(range(len(reward))):
        goes_on = 1 - ended[step]
        error = reward[step] + GAMMA * value[step + 1] * goes_on - value[step]
        last = found[step] = error + GAMMA * LAMBDA * goes_on * last
    return found


def train(walk: Walk, seed: int) -> Iterator[tuple[int, Policy]]:
    """Train; yield environment steps and the policy after every update."""
    torch.manual_seed(seed)
    torch.set_num_threads(2)
    envs, view = walk.make_envs(NUM_ENVS), OwnView(walk, NUM_ENVS)
    actions = envs.single_action_space.shape[0]
    policy = Policy(view.size, actions)
    optimizer = torch.optim.Adam(policy.parameters(), LEARNING_RATE, eps=1e-5)
    observation, _ = envs.reset(seed=seed)
    # One step more than a rollout: the last one has the value after it, and is the first of the next.
    seen = torch.zeros(STEPS + 1, NUM_ENVS, view.size)
    taken, log_prob = torch.zeros(STEPS + 1, NUM_ENVS, actions), torch.zeros(STEPS + 1, NUM_ENVS)
    value, reward, ended = torch.zeros(STEPS + 1, NUM_ENVS), torch.zeros(STEPS, NUM_ENVS), torch.zeros(STEPS, NUM_ENVS)
    total = 0

    @torch.no_grad()
    def sample(step: int, inputs: np.ndarray) -> np.ndarray:
        policy.observe(inputs)
        seen[step] = policy.normalised(inputs)
        distribution = policy.distribution(seen[step])
        taken[step] = distribution.sample()
        log_prob[step] = distribution.log_prob(taken[step]).sum(1)
        value[step] = policy.critic(seen[step]).squeeze(1)
        return taken[step].clamp(-1, 1).numpy()

    def update(rows: torch.Tensor, advantage: torch.Tensor, target: torch.Tensor) -> None:
        """Make a step for these `rows` of all states."""
        distribution = policy.distribution(seen.flatten(0, 1)[rows])
        change = distribution.log_prob(taken.flatten(0, 1)[rows]).sum(1) - log_prob.flatten()[rows]
        with torch.no_grad():
            divergence = float((change.exp() - 1 - change).mean())
        factor = 1 / 1.5 if divergence > 2 * TARGET_KL else 1.5 if divergence < TARGET_KL / 2 else 1.0
        for group in optimizer.param_groups:
            group["lr"] = float(np.clip(group["lr"] * factor, 1e-5, 1e-2))
        scaled = (advantage[rows] - advantage[rows].mean()) / (advantage[rows].std() + 1e-8)
        ratio = change.exp()
        gain = torch.minimum(ratio * scaled, ratio.clamp(1 - CLIP, 1 + CLIP) * scaled).mean()
        error = ((policy.critic(seen.flatten(0, 1)[rows]).squeeze(1) - target[rows]) ** 2).mean()
        optimizer.zero_grad()
        (VALUE_WEIGHT * error - gain).backward()
        nn.utils.clip_grad_norm_(policy.parameters(), MAX_NORM)
        optimizer.step()

    action = view.act(observation, lambda inputs: sample(0, inputs))
    while True:
        for step in range(STEPS):
            observation, gained, terminated, truncated, _ = envs.step(action)
            cut = torch.as_tensor(truncated & ~terminated)
            # At a time limit the value of the last state stands for that of the one after it.
            reward[step] = torch.as_tensor(gained, dtype=torch.float32) + GAMMA * value[step] * cut
            ended[step] = torch.as_tensor(terminated | truncated)
            view.restart(np.flatnonzero(terminated | truncated))
            action = view.act(observation, lambda inputs, step=step: sample(step + 1, inputs))
        advantage = advantages(reward, value, ended)
        target = (advantage + value[:-1]).flatten()
        for _ in range(EPOCHS):
            for rows in torch.randperm(STEPS * NUM_ENVS).chunk(MINIBATCHES):
                update(rows, advantage.flatten(), target)
        for kept in (seen, taken, log_prob, value):
            kept[0] = kept[STEPS]
        total += STEPS * NUM_ENVS
        yield total, policy
