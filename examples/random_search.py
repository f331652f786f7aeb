"""A custom algorithm: random search samples neighbours of the best policy and keeps one that is better."""

# PYTHONPATH=examples shes train point-gather --import random_search --algorithm random-search --tries 32

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

import shes
from shes.algorithms.contract import Algorithm, Report
from shes.es.level import LevelParameters
from shes.rollout.episodes import EpisodeTask, Generation
from shes.rollout.roll_out import roll_out_tasks
from shes.settings import Ge, Gt, Settings


@dataclass(frozen=True, kw_only=True)
class SearchSettings(Settings):
    """Random search."""

    tries: Annotated[int, Ge(1)] = 64
    """Neighbours sampled in a generation."""
    spread: Annotated[float, Gt(0)] = 0.5
    """Standard deviation of the difference from the best policy, for each parameter."""


class State(NamedTuple):
    """State between generations: the best policy [D] and its return, among others."""

    seed: int
    theta: np.ndarray
    generation: int = 0
    env_steps: int = 0
    best: float = -np.inf


class RandomSearch(Algorithm[State]):
    """Linear policies without goals, whose perturbations are slices of the shared noise table."""

    sections: ClassVar = {"search": SearchSettings}

    def __init__(self, problem):
        super().__init__(problem, problem.flat_design(hidden=()))

    def start(self, seed):
        return State(seed=seed, theta=np.zeros(self.design.dims[0], np.float32))

    def run(self, state, backend):
        dim, own = self.design.dims[0], self.problem.settings.search
        while True:
            rng = np.random.default_rng((state.seed, state.generation))  # the same after a crash
            places, seed = rng.integers(0, self.table.size - dim + 1, own.tries).tolist(), int(rng.integers(2**63))
            task = {"signs": ((1,),), "slots": (0,), "seeds": (seed,)}
            tasks = [EpisodeTask(member=i, noise_index=(place,), **task) for i, place in enumerate(places)]
            common = {"sigma": own.spread, "episodes_per_policy": 1}
            results = roll_out_tasks(tasks, Generation(levels=self.parameters(state), **common), backend)
            returns, theta, best = results.fitness[0], state.theta, state.best
            if returns.max() > best:
                step = self.table.slice(places[returns.argmax()], dim)
                theta, best = theta + np.float32(own.spread) * step, float(returns.max())
            state = State(state.seed, theta, state.generation + 1, state.env_steps + int(results.steps.sum()), best)
            columns = {"policy_return_mean": float(returns.mean()), "policy_return_max": best}
            yield Report(state=state, columns=columns, log=results.log)

    def to_arrays(self, state):
        return {name: np.asarray(value) for name, value in state._asdict().items()}

    def from_arrays(self, arrays):
        return State(*(arrays[name] if name == "theta" else arrays[name].item() for name in State._fields))

    def parameters(self, state):
        zeros = np.zeros(self.design.observation_sizes[0])
        return (LevelParameters(theta=state.theta, mean=zeros, inverse_std=zeros + 1),)


shes.register_algorithm("random-search", RandomSearch)

if __name__ == "__main__":
    print(shes.train("point-gather", algorithm="random-search", preset="smoke", generations=10, backend="serial").best)
