"""A complete hierarchical run: train, evaluate, load the agent, act in the Gymnasium environment.

In fifteen short generations the primitive learns to reach its goals, while the controller has hardly changed.
"""

import gymnasium as gym

import shes


def main() -> None:
    """Train two levels on two worker processes, evaluate them, and play an episode."""
    run = shes.train(
        "point-gather",
        preset="smoke",
        population_size=120,
        horizon=150,
        controller_interval=10,
        learning_rate=0.04,
        generations=15,
        num_workers=2,
    )
    print(f"trained {run.generation} generations: {run.path}")

    for checkpoint in ("0", "last"):
        found = shes.evaluate(run.path, checkpoint=checkpoint, episodes=50).summary()
        primitive, score = found["primitive_return_mean"], found["score_mean"]
        print(f"checkpoint {checkpoint}: primitive return {primitive:.1f}; score {score:.2f}")

    agent = shes.load(run.path, checkpoint="last")
    env = gym.make("shes/PointGather-v0")
    observation, _ = env.reset(seed=0)
    agent.reset()
    total, steps, is_over = 0.0, 0, False
    while not is_over:
        observation, reward, terminated, truncated, _ = env.step(agent.act(observation))
        total, steps, is_over = total + float(reward), steps + 1, terminated or truncated
    env.close()
    print(f"one episode of {steps} steps: return {total:+.0f}")


if __name__ == "__main__":
    main()
