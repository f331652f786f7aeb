"""The evolution strategy alone, on plain vectors: ask for candidates, tell how good they are.

The sphere function is `-|x - target|^2`: as large as can be, 0, where x is the target.
"""

import numpy as np

from shes.es import EvolutionStrategy

DIM = 20


def main() -> None:
    """Find the target."""
    target = np.linspace(-1, 1, DIM)
    es = EvolutionStrategy(DIM, population_size=40, sigma=0.1, learning_rate=0.05)
    for generation in range(1, 201):
        candidates = es.ask()  # [40, 20]
        es.tell(-((candidates - target) ** 2).sum(axis=1))  # higher is better
        if generation % 50 == 0:
            print(f"generation {generation:3}: distance {np.linalg.norm(es.mean - target):.4f}")


if __name__ == "__main__":
    main()
