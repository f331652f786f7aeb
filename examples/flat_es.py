"""A flat evolution strategy: one network from observation to action, no hierarchy, no worker processes.

All policies of a generation run at once: one batch of simulations, one stacked matrix product per layer and step.
`shes train point-gather --algorithm es` does the same with workers, checkpoints and evaluations.
"""

import numpy as np

from shes.agents.mlp import MLP
from shes.envs.named_environments import ENVIRONMENTS
from shes.envs.tasks.task import Task
from shes.es import EvolutionStrategy

POLICIES, EPISODES, STEPS, GENERATIONS = 60, 2, 100, 30


def play(task: Task, mlp: MLP, policies: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Return the mean return [P] of `policies` [P, D] over the episodes with these `seeds` [E], the same for all."""
    episodes = np.arange(task.num_episodes)
    high = np.array([element.high for element in task.observation_spec])
    scale = np.where(np.isfinite(high), high, 10.0)  # positions, in metres, reach 12
    layers = mlp.layers(policies)
    task.reset(episodes, np.tile(seeds, len(policies)))
    for _ in range(STEPS):
        observation = (task.observe() / scale).astype(np.float32)
        action = mlp.forward(layers, observation.reshape(len(policies), len(seeds), -1))
        task.step(episodes, action.reshape(task.num_episodes, -1) * task.control_limit)
    return task.running_return.reshape(len(policies), len(seeds)).mean(axis=1)


def main() -> None:
    """Train, and print the return of the mean policy on a hundred test episodes every ten generations."""
    task = ENVIRONMENTS["point-gather"].make(POLICIES * EPISODES)
    test, test_seeds = ENVIRONMENTS["point-gather"].make(100), np.arange(100)
    mlp = MLP(task.observation_size, (16,), task.action_size)
    rng = np.random.default_rng(1)
    start = mlp.initial(rng)
    es = EvolutionStrategy(len(start), population_size=POLICIES, sigma=0.1, learning_rate=0.05, initial=start)
    for generation in range(GENERATIONS + 1):
        if generation > 0:  # 0 is the untrained policy
            es.tell(play(task, mlp, es.ask(), rng.integers(2**62, size=EPISODES)))
        if generation % 10 == 0:
            print(f"generation {generation:2}: return {play(test, mlp, es.mean[None], test_seeds)[0]:.2f}")


if __name__ == "__main__":
    main()
