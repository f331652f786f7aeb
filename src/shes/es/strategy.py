"""The ES core for plain vectors: ask for candidates, tell their fitness. Maximises.

With one level this is S-ES (Salimans et al. 2017); with several, the update of SHES (paper, Algorithm 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import index
from typing import SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shes.errors import ConfigError, ShapeError
from shes.es.level import (
    LevelState,
    TrainState,
    UpdateRule,
    draw_noise_index,
    perturb,
    select_fitness,
    update_level,
)
from shes.es.noise import NoiseTable
from shes.es.optimizers import make_optimizer
from shes.es.perturbation import Signs, check_perturbation, make_perturbation
from shes.es.shaping import make_fitness_shaping
from shes.es.statistics import ObservationStatistics
from shes.types import F32Array, F64Array, IntArray

__all__ = ["EvolutionStrategy"]


class EvolutionStrategy:
    """Evolution strategy with mirrored noise, by ask and tell; with centred ranks and Adam unless told otherwise.

    ```python
    es = EvolutionStrategy(10, population_size=40, sigma=0.1, learning_rate=0.05)
    for _ in range(100):
        candidates = es.ask()                        # [40, 10]
        es.tell([-np.sum(x**2) for x in candidates])
    es.mean                                          # [10]
    ```
    """

    def __init__(
        self,
        dim: int | Sequence[int],
        *,
        population_size: int,
        sigma: float,
        learning_rate: float = 0.01,
        weight_decay: float = 0.0,
        mirrored: str = "quad",
        perturbation: str = "many_to_many",
        fitness_shaping: str = "centred_rank",
        rank_ties: str = "average",
        top_fraction: float = 0.2,
        optimizer: str = "adam",
        momentum: float = 0.9,
        initial: ArrayLike | Sequence[ArrayLike] | None = None,
        seed: int = 0,
        noise_table_size: int = 1_000_000,
        state: TrainState | None = None,
    ) -> None:
        """Start at `initial`, or go on from `state`.

        Args:
            dim: Number of parameters, or one number per level.
            population_size: Candidates per generation, mirrored ones included.
            sigma: Standard deviation of the perturbations.
            learning_rate: The optimizer's rate.
            weight_decay: Coefficient of the parameters subtracted from the gradient estimate.
            mirrored: `quad`, `pair` or `none`; with one level, `quad` and `pair` are the same.
            perturbation: `many_to_many` (all levels at once), `one_to_many` (in turns) or `one_to_many_halves`.
            fitness_shaping: `centred_rank`, `z_score` or `top_fraction`.
            rank_ties: `average` or `index`.
            top_fraction: Share of the candidates that count, for `top_fraction`.
            optimizer: `adam`, `sgd` or `clipup`.
            momentum: Of `sgd` and `clipup`.
            initial: Start vector [dim] (a sequence of them with several levels); zeros if none.
            seed: Seed of every draw.
            noise_table_size: Normals in the shared table, at least twice the largest `dim`.
            state: `state` of an earlier strategy with the same arguments.

        Raises:
            ConfigError: A value is out of range, or the population is not a multiple of the mirrored group.
            UnknownNameError: A name is not known.
            ShapeError: `initial` or `state` does not fit `dim`.
        """
        dims = tuple(dim) if isinstance(dim, Sequence) else (dim,)
        self._single = not isinstance(dim, Sequence)
        if not dims or not all(_is_whole(size, 1) for size in dims):
            raise ConfigError(f"dim must be a positive whole number, or one per level, got {dim!r}.")
        self.dims: tuple[int, ...] = tuple(int(size) for size in dims)
        if not 0 < sigma < float("inf"):
            raise ConfigError(f"sigma must be a positive number, got {sigma}.")
        if not _is_whole(population_size, 1):
            raise ConfigError(f"population_size must be a positive whole number, got {population_size!r}.")
        if not _is_whole(seed, 0):
            raise ConfigError(f"seed must be a whole number of at least 0, got {seed!r}.")
        check_perturbation(perturbation, population_size, mirrored, [True] * len(self.dims))
        self.perturbation = make_perturbation(perturbation)
        self.population_size = population_size
        self.mirrored = mirrored
        self.sigma = sigma
        if not 0 < learning_rate < float("inf"):
            raise ConfigError(f"learning_rate must be a positive number, got {learning_rate}.")
        self.learning_rate = learning_rate
        self.rule = UpdateRule(
            weight_decay=weight_decay,
            shaping=make_fitness_shaping(fitness_shaping, ties=rank_ties, fraction=top_fraction),
            optimizer=make_optimizer(optimizer, momentum=momentum),
        )
        self.table = NoiseTable.open(noise_table_size)
        for level_dim in self.dims:
            self.table.check_dim(level_dim)
        self.state = self._start(initial, seed) if state is None else state
        if tuple(len(level.theta) for level in self.state.levels) != self.dims:
            raise ShapeError(f"state has levels of {[len(x.theta) for x in self.state.levels]}, dim is {self.dims}.")

    @property
    def mean(self) -> F32Array | tuple[F32Array, ...]:
        """The current solution [dim], or one per level: a copy."""
        thetas = tuple(level.theta.copy() for level in self.state.levels)
        return thetas[0] if self._single else thetas

    def ask(self) -> F32Array | tuple[F32Array, ...]:
        """Return this generation's candidates [n, dim], or one such array per level; asking twice gives the same."""
        candidates = tuple(np.empty((self.population_size, dim), np.float32) for dim in self.dims)
        signs = self._signs()
        noise_index = self._noise_index(len(signs))
        for level, (state, out) in enumerate(zip(self.state.levels, candidates, strict=True)):
            for i, sign in enumerate(signs[:, :, level].ravel().tolist()):
                noise = self.table.slice(int(noise_index[level, i // signs.shape[1]]), self.dims[level])
                perturb(state.theta, noise, self.sigma * sign, out[i])
        return candidates[0] if self._single else candidates

    def tell(self, fitness: ArrayLike) -> None:
        """Update from the fitness [n] of the candidates (higher is better), or [L, n] with one row per level.

        Raises:
            ShapeError: `fitness` has another shape.
            PolicyError: A fitness is not finite.
        """
        values: F64Array = np.array(fitness, dtype=np.float64)
        expected = (self.population_size,) if self._single else (len(self.dims), self.population_size)
        if values.shape != expected:
            raise ShapeError(f"fitness must have shape {expected}, got {values.shape}.")
        rows = values[None] if self._single else values
        signs = self._signs()
        noise_index = self._noise_index(len(signs))
        levels = tuple(self._update(i, rows[i], signs[:, :, i], noise_index[i]) for i in range(len(self.dims)))
        self.state = replace(self.state, generation=self.state.generation + 1, levels=levels)

    def _update(self, level: int, fitness: F64Array, signs: NDArray[np.int8], noise_index: IntArray) -> LevelState:
        """Return level number `level` after its update from `fitness` [n]."""
        state = self.state.levels[level]
        if not signs.any():
            return state
        shaped = self.rule.shaping(select_fitness(fitness, signs))
        return update_level(state, shaped, signs, noise_index, self.table, self.rule, self.learning_rate).level

    def _signs(self) -> Signs:
        """Return the signs [G, M, L] of this generation."""
        return self.perturbation.signs(
            self.state.generation, self.population_size, self.mirrored, [True] * len(self.dims)
        )

    def _noise_index(self, num_groups: int) -> IntArray:
        """Return where the noise of each group starts [L, G]."""
        return draw_noise_index(self.state.seed, self.state.generation, num_groups, self.dims, self.table.size)

    def _start(self, initial: ArrayLike | Sequence[ArrayLike] | None, seed: int) -> TrainState:
        """Return the state before the first generation."""
        if initial is None:
            starts = [np.zeros(dim, np.float32) for dim in self.dims]
        else:
            starts = [np.array(x, np.float32) for x in ([initial] if self._single else initial)]  # type: ignore[union-attr]
        if tuple(x.shape for x in starts) != tuple((dim,) for dim in self.dims):
            raise ShapeError(f"initial must have the shape of dim {self.dims}, got {[x.shape for x in starts]}.")
        levels = tuple(
            LevelState(
                name="policy" if self._single else f"level_{i}",
                theta=x,
                optimizer=self.rule.optimizer.start(len(x)),
                statistics=ObservationStatistics.empty(0),
            )
            for i, x in enumerate(starts)
        )
        return TrainState(seed=seed, generation=0, env_steps=0, levels=levels)


def _is_whole(value: object, least: int) -> bool:
    """Tell whether `value` is a whole number of at least `least`."""
    return isinstance(value, SupportsIndex) and not isinstance(value, bool) and index(value) >= least
