"""A learner of one's own: random search on policies, which tries neighbours of the best one and keeps a better one.

`python examples/random_search.py`, or `PYTHONPATH=examples shes train point-gather --import random_search --algorithm
random-search`. The rest is as with any learner: workers, checkpoints, `shes resume` after a crash, plots, videos.
"""

from dataclasses import dataclass

import numpy as np

import shes
from shes.algorithms.contract import Algorithm, Report
from shes.algorithms.roll_out import roll_out_tasks
from shes.es.level import LevelParameters
from shes.hierarchy.episodes import EpisodeTask, Generation

TRIES, SIGMA = 64, 0.5


@dataclass(frozen=True, kw_only=True)
class State:
    """What goes on from generation to generation."""

    seed: int
    generation: int
    env_steps: int
    theta: np.ndarray  # the best policy so far [D]
    best: float  # its return


class RandomSearch(Algorithm[State]):
    """Linear policies without goals; workers draw the perturbations from the shared noise table."""

    def __init__(self, problem):
        super().__init__(problem, problem.flat_design(hidden=()))

    def start(self, seed):
        return State(seed=seed, generation=0, env_steps=0, theta=np.zeros(self.design.dims[0], "f4"), best=-np.inf)

    def run(self, state, backend):
        dim = self.design.dims[0]
        while True:
            rng = np.random.default_rng((state.seed, state.generation))  # the same after a crash
            places = rng.integers(0, self.table.size - dim + 1, TRIES).tolist()
            seed = int(rng.integers(2**63))
            tasks = [
                EpisodeTask(member=number, noise_index=(place,), signs=((1,),), slots=(0,), seeds=(seed,))
                for number, place in enumerate(places)
            ]
            levels = self.parameters(state)
            generation = Generation(levels=levels, sigma=SIGMA, episodes_per_policy=1, is_evaluation=False)
            results = roll_out_tasks(tasks, generation, backend)
            returns, theta, best = results.fitness[0], state.theta, state.best
            winner = int(returns.argmax())
            if returns[winner] > best:
                best = float(returns[winner])
                theta = theta + np.float32(SIGMA) * self.table.slice(places[winner], dim)
            steps = state.env_steps + int(results.steps.sum())
            state = State(seed=state.seed, generation=state.generation + 1, env_steps=steps, theta=theta, best=best)
            columns = {"policy_return_mean": float(returns.mean()), "policy_return_max": best}
            yield Report(state=state, columns=columns, log=results.log)

    def to_arrays(self, state):
        return {name: np.asarray(value) for name, value in vars(state).items()}

    def from_arrays(self, arrays):
        numbers = {name: int(arrays[name]) for name in ("seed", "generation", "env_steps")}
        return State(**numbers, theta=arrays["theta"], best=float(arrays["best"]))

    def parameters(self, state):
        inputs = self.design.observation_sizes[0]
        return (LevelParameters(theta=state.theta, mean=np.zeros(inputs), inverse_std=np.ones(inputs)),)


shes.register_algorithm("random-search", RandomSearch)

if __name__ == "__main__":
    run = shes.train("point-gather", algorithm="random-search", preset="smoke", generations=10, backend="serial")
    print(f"best evaluation: score {run.best.score:.2f}, kept in {run.path}")
