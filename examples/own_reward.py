"""A primitive reward of your own: what the controller pays its primitive for each step.

This one pays for metres in the direction of the goal, and does not mind overshooting it.
"""

import numpy as np

import shes
from shes.hierarchy.rewards import PrimitiveReward
from shes.types import F64Array


class Metres(PrimitiveReward):
    """How far the robot has come in the direction of its goal since that was set."""

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the reward [N] for `displacement` [N, 2] when the goals lay at `goal` [N, 2], in metres."""
        return (displacement * goal).sum(axis=1) / np.linalg.norm(goal, axis=1)


def main() -> None:
    """Train with it for a few generations, and look at what the primitive earns before and after."""
    shes.register_primitive_reward("way", Metres)
    run = shes.train(
        "point-gather",
        preset="smoke",
        primitive_reward="way",
        population_size=80,
        horizon=100,
        controller_interval=10,
        learning_rate=0.04,
        generations=20,
        num_workers=2,
    )
    for when, checkpoint in (("before", "0"), ("after", "last")):
        evaluation = shes.evaluate(run.path, checkpoint=checkpoint, episodes=50)
        print(f"{when}: the primitive earns {evaluation.primitive_returns.mean():.1f} in an episode")


if __name__ == "__main__":
    main()
