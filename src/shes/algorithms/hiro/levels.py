"""The levels of a run of HIRO or TD3: what is fixed about each, and its state between generations.

The parameters of a network are a flat vector, layer by layer, as in `shes.policies.mlp`.

D parameters of an actor, Q of a critic, A outputs of an actor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from shes.algorithms.hiro.replay import Replay
from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.policies.mlp import MLP
from shes.types import ArrayHeader, F32Array

_OUTPUT_RANGE = 0.003
"""Initial weights and biases of output layers are uniform in plus and minus this."""
ArrayT = TypeVar("ArrayT", bound=ArrayHeader)
_STATISTICS = ("observation_total", "observation_total_squares")


@dataclass(frozen=True, kw_only=True)
class UpdateHyperparameters:
    """Settings of the update of one level. The fields are hashable, because an update is compiled for each."""

    half_range: tuple[float, ...]
    """Largest absolute value of each output of the actor [A]."""
    noise_std: tuple[float, ...]
    """Standard deviation of the noise on the target actor's outputs [A]."""
    noise_clip: tuple[float, ...]
    """Largest absolute value of that noise [A]."""
    actor_learning_rate: float
    critic_learning_rate: float
    target_rate: float
    policy_delay: int
    has_huber_loss: bool


@dataclass(frozen=True, kw_only=True)
class Level:
    """Networks, hyperparameters and empty replay buffer of a level."""

    name: str
    actor: MLP
    hyperparameters: UpdateHyperparameters
    exploration_std: tuple[float, ...]
    """Standard deviation of the exploration noise on each output of the actor [A]."""
    replay: Replay
    """Its buffer before the first transition."""

    @property
    def critic_shapes(self) -> tuple[tuple[int, int], ...]:
        """Shape of the weights of each layer of a critic. The action is an input of every hidden layer."""
        inputs, *hidden, actions = self.actor.sizes
        sizes = pairwise((inputs, *hidden))
        return (*((fan_in + actions, fan_out) for fan_in, fan_out in sizes), ((inputs, *hidden)[-1], 1))

    @property
    def actor_shapes(self) -> tuple[tuple[int, int], ...]:
        """Shape of the weights of each layer of the actor."""
        return tuple(pairwise(self.actor.sizes))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of the learner, by name."""
        actor = (self.actor.num_params,)
        critics = (2, sum((fan_in + 1) * fan_out for fan_in, fan_out in self.critic_shapes))
        networks = {"actor": actor, "critics": critics}
        return {
            f"{part}{name}": shape for part in ("", "target_", "mean_", "square_") for name, shape in networks.items()
        }

    def start(self, rng: np.random.Generator) -> LearnerState:
        """Return the state before the first transition."""
        actor = _initial(self.actor_shapes, rng)
        critics = np.stack([_initial(self.critic_shapes, rng) for _ in range(2)])
        networks = {"actor": actor, "critics": critics}
        zeros = {name: np.zeros(shape, np.float32) for name, shape in self.shapes.items()}
        targets = {f"target_{name}": array.copy() for name, array in networks.items()}
        return LearnerState(
            learner=zeros | networks | targets,
            num_updates=0,
            statistics=ObservationStatistics.empty(self.actor.sizes[0]),
            replay=self.replay,
        )

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> LearnerState:
        """Return the state that `LearnerState.to_arrays` converted; raise KeyError or ValueError if it is not one."""
        self.check(arrays)
        learner = {name: arrays[name] for name in self.shapes}
        total, squares = (arrays[name] for name in _STATISTICS)
        if not all(np.isfinite(array).all() for array in (*learner.values(), total, squares)):
            raise ValueError(f"the networks or statistics of the {self.name} hold NaN or infinity")
        counts = [int(arrays[name]) for name in ("num_updates", "observation_count")]
        if min(counts) < 0:
            raise ValueError(f"a count of the {self.name} is negative")
        replay = self.replay.from_arrays(within("replay", arrays))
        statistics = ObservationStatistics(count=counts[1], total=total, total_squares=squares)
        return LearnerState(learner=learner, num_updates=counts[0], statistics=statistics, replay=replay)

    def check(self, headers: Mapping[str, ArrayHeader]) -> None:
        """Raise KeyError or ValueError unless arrays with these headers can be a state of this level."""
        inputs = (self.actor.sizes[0],)
        expected = {name: (np.dtype(np.float32), shape) for name, shape in self.shapes.items()}
        expected |= {name: (np.dtype(np.float64), inputs) for name in _STATISTICS}
        expected |= {name: (np.dtype(np.int64), ()) for name in ("num_updates", "observation_count", "replay/end")}
        for name, (dtype, shape) in expected.items():
            if (headers[name].dtype, headers[name].shape) != (dtype, shape):
                found = f"{headers[name].dtype} of shape {headers[name].shape}"
                raise ValueError(f"{self.name}/{name} is {found}, not {dtype} of shape {shape}")
        self.replay.check(within("replay", headers))


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnerState:
    """State of a level between generations."""

    learner: Mapping[str, F32Array]
    """Flat parameters of the networks and of their targets, and the moments of Adam (`mean_`, `square_`), by name."""
    num_updates: int
    """Number of updates of the critics."""
    statistics: ObservationStatistics
    """Statistics of the inputs; empty if they are not normalised."""
    replay: Replay

    @property
    def parameters(self) -> LevelParameters:
        """Parameters and normalisation of the actor."""
        return LevelParameters.of(self.learner["actor"], self.statistics)

    def without_replay(self) -> LearnerState:
        """Return the state with an empty buffer."""
        return replace(self, replay=self.replay.emptied())

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the state as arrays by name."""
        return {
            **self.learner,
            "num_updates": np.array(self.num_updates),
            "observation_count": np.array(self.statistics.count),
            "observation_total": self.statistics.total,
            "observation_total_squares": self.statistics.total_squares,
            **{f"replay/{name}": array for name, array in self.replay.to_arrays().items()},
        }


def within(prefix: str, arrays: Mapping[str, ArrayT]) -> dict[str, ArrayT]:
    """Return those of `arrays` whose names begin with `prefix/`, without it."""
    return {name.removeprefix(f"{prefix}/"): array for name, array in arrays.items() if name.startswith(f"{prefix}/")}


def _initial(shapes: tuple[tuple[int, int], ...], rng: np.random.Generator) -> F32Array:
    """Return initial parameters of a network [D]: hidden weights are uniform in 1 / sqrt(inputs), their biases 0."""
    parts = list[np.ndarray]()
    for fan_in, fan_out in shapes[:-1]:
        limit = fan_in**-0.5
        parts += [rng.uniform(-limit, limit, fan_in * fan_out), np.zeros(fan_out)]
    fan_in, fan_out = shapes[-1]
    parts.append(rng.uniform(-_OUTPUT_RANGE, _OUTPUT_RANGE, (fan_in + 1) * fan_out))
    return np.concatenate(parts).astype(np.float32)
