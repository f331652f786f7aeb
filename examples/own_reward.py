"""A custom primitive reward: the intrinsic reward of the primitive in each step.

It rewards metres in the direction of the goal, also beyond the goal.
"""

import numpy as np

import shes
from shes.agents.rewards import PrimitiveReward
from shes.types import F64Array


class Metres(PrimitiveReward):
    """Distance covered in the direction of the goal since it was set, in metres."""

    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return `moved` [N, 2] projected on the direction of `goal` [N, 2], in metres [N]."""
        return (moved * goal).sum(axis=1) / np.linalg.norm(goal, axis=1)


def main() -> None:
    """Train with this reward for a few generations, and print the primitive's return before and after."""
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
        print(f"{when}: primitive return {evaluation.primitive_returns.mean():.1f} per episode")


if __name__ == "__main__":
    main()
