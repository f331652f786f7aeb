"""The evolution strategy on plain vectors: ask for candidates, tell their fitness.

It maximises the sphere function `-|x - target|^2`, whose maximum is 0 at the target.
"""

import numpy as np

from shes.es import EvolutionStrategy

DIM = 20


def main() -> None:
    """Maximise, and print the distance from the target."""
    target = np.linspace(-1, 1, DIM)
    es = EvolutionStrategy(DIM, population_size=40, sigma=0.1, learning_rate=0.05)
    for generation in range(1, 201):
        candidates = es.ask()  # [40, 20]
        es.tell(-((candidates - target) ** 2).sum(axis=1))  # higher is better
        if generation % 50 == 0:
            print(f"generation {generation:3}: distance {np.linalg.norm(es.mean - target):.4f}")


if __name__ == "__main__":
    main()
