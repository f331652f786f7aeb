"""The evolution strategy for plain vectors: ask for candidates, tell their fitness. Maximises.

With one level this is S-ES (Salimans et al. 2017); with several, the update of SHES (paper, Algorithm 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from shes.errors import ConfigError, ShapeError
from shes.es.level import LevelState, StrategyState, UpdateRule, draw_noise_index, perturb, update_level
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import Signs, check_population_size, member_signs
from shes.es.shaping import FITNESS_SHAPINGS
from shes.settings import Ge, Gt, checked
from shes.types import F32Array, F64Array, IntArray, is_whole


class EvolutionStrategy:
    """Evolution strategy with mirrored noise and an ask-and-tell interface.

    ```python
    es = EvolutionStrategy(3, population_size=40, sigma=0.1, learning_rate=0.05)
    for _ in range(100):
        candidates = es.ask()  # [40, 3]
        es.tell(-((candidates - [1, 2, 3]) ** 2).sum(axis=1))
    es.mean  # near [1, 2, 3]
    ```

    Args:
        dim: Number of parameters, or one number per level.
        population_size: Candidates per generation, mirrored ones included.
        sigma: Standard deviation of the perturbations.
        learning_rate: Learning rate of the optimizer.
        weight_decay: Coefficient of the parameters subtracted from the gradient estimate.
        mirrored: `quad`, `pair` or `none`. With one level, `quad` and `pair` are the same.
        perturbation: One of `shes.es.perturbation.PERTURBATIONS`.
        fitness_shaping: One of `FITNESS_SHAPINGS`.
        optimizer: One of `OPTIMIZERS`.
        initial: Initial vector [dim], or a sequence of them with several levels; zeros if None.
        seed: Seed of all random numbers.
        noise_table_size: Normals in the shared table, at least twice the largest `dim`.
        state: `state` of an earlier strategy with the same arguments.
    """

    @checked
    def __init__(
        self,
        dim: int | Sequence[int],
        *,
        population_size: Annotated[int, Ge(1)],
        sigma: Annotated[float, Gt(0)],
        learning_rate: Annotated[float, Gt(0)] = 0.01,
        weight_decay: Annotated[float, Ge(0)] = 0.0,
        mirrored: str = "quad",
        perturbation: str = "many_to_many",
        fitness_shaping: str = "centred_rank",
        optimizer: str = "adam",
        initial: ArrayLike | Sequence[ArrayLike] | None = None,
        seed: Annotated[int, Ge(0)] = 0,
        noise_table_size: int = 1_000_000,
        state: StrategyState | None = None,
    ) -> None:
        self._single = not isinstance(dim, Sequence)
        dims = tuple(dim) if isinstance(dim, Sequence) else (dim,)
        if not dims or not all(is_whole(size) and size > 0 for size in dims):
            raise ConfigError(f"dim must be a positive whole number, or one per level, got {dim!r}.")
        self.dims: tuple[int, ...] = tuple(int(size) for size in dims)
        self.population_size, self.mirrored = population_size, mirrored
        self.sigma, self.learning_rate = sigma, learning_rate
        self.perturbation = perturbation
        self.rule = UpdateRule(
            weight_decay=weight_decay,
            shaping=FITNESS_SHAPINGS.find(fitness_shaping)(),
            optimizer=OPTIMIZERS.find(optimizer)(),
        )
        check_population_size(perturbation, mirrored, population_size, [True] * len(dims))
        self.table = NoiseTable.open(noise_table_size, max(self.dims))
        self.state = self._start(initial, seed) if state is None else state
        if tuple(len(level.theta) for level in self.state.levels) != self.dims:
            raise ShapeError(f"state has levels of {[len(x.theta) for x in self.state.levels]}, dim is {self.dims}.")
        vectors, own = list(self.state.levels[0].optimizer.slots), list(self.rule.optimizer.slots)
        if vectors != own:
            raise ConfigError(
                f"optimizer {optimizer!r} keeps {' and '.join(own)}, but state is of an optimizer that keeps "
                f"{' and '.join(vectors)}. Name the optimizer of the earlier strategy."
            )

    @property
    def mean(self) -> F32Array | tuple[F32Array, ...]:
        """Copy of the current solution [dim], or one per level."""
        thetas = tuple(level.theta.copy() for level in self.state.levels)
        return thetas[0] if self._single else thetas

    def ask(self) -> F32Array | tuple[F32Array, ...]:
        """Return the candidates of this generation [n, dim], or one such array per level.

        The result is the same until the next `tell`.
        """
        candidates = tuple(np.empty((self.population_size, dim), np.float32) for dim in self.dims)
        signs, noise_index = self._draws()
        for level, (state, out) in enumerate(zip(self.state.levels, candidates, strict=True)):
            for i, sign in enumerate(signs[:, :, level].ravel().tolist()):
                noise = self.table.slice(int(noise_index[level, i // signs.shape[1]]), self.dims[level])
                perturb(state.theta, noise, self.sigma * sign, out[i])
        return candidates[0] if self._single else candidates

    def tell(self, fitness: ArrayLike) -> None:
        """Update the levels from the fitness [n] of the candidates (higher is better), or [L, n] with several levels.

        Raise ShapeError for another shape, and PolicyError unless every fitness is finite.
        """
        values: F64Array = np.array(fitness, dtype=np.float64)
        expected = (self.population_size,) if self._single else (len(self.dims), self.population_size)
        if values.shape != expected:
            raise ShapeError(f"fitness must have shape {expected}, got {values.shape}.")
        values = values.reshape(len(self.dims), -1)
        signs, noise_index = self._draws()
        levels, rule = list[LevelState](), self.rule
        for i, level in enumerate(self.state.levels):
            shaped, own = rule.shape(values[i], signs[:, :, i]), signs[:, :, i]
            update = update_level(level, shaped, own, noise_index[i], self.table, rule, self.learning_rate)
            levels.append(update.level)
        self.state = replace(self.state, generation=self.state.generation + 1, levels=tuple(levels))

    def _draws(self) -> tuple[Signs, IntArray]:
        """Return the signs of this generation [G, M, L], and where the noise of each group starts [L, G]."""
        learns, generation = [True] * len(self.dims), self.state.generation
        signs = member_signs(self.perturbation, self.mirrored, self.population_size, learns, generation)
        return signs, draw_noise_index(self.state.seed, generation, len(signs), self.dims, self.table.size)

    def _start(self, initial: ArrayLike | Sequence[ArrayLike] | None, seed: int) -> StrategyState:
        starts: Any = [np.zeros(dim) for dim in self.dims]
        if initial is not None:
            starts = [initial] if self._single else initial
        with np.errstate(over="ignore"):
            starts = [np.array(start, np.float32) for start in starts]
        if tuple(x.shape for x in starts) != tuple((dim,) for dim in self.dims):
            raise ShapeError(f"initial must have the shape of dim {self.dims}, got {[x.shape for x in starts]}.")
        if not all(np.isfinite(start).all() for start in starts):
            raise ConfigError(
                "initial holds NaN, infinity, or a number larger than 3.4e38, the most that single precision holds. "
                "Begin with finite numbers."
            )
        levels = tuple(
            LevelState.start("policy" if self._single else f"level_{i}", x, self.rule.optimizer, 0)
            for i, x in enumerate(starts)
        )
        return StrategyState(seed=seed, levels=levels)
