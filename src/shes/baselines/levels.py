"""The levels of a run of HIRO or TD3: their networks and replay buffers, and their state between generations.

Parameters are trees, which JAX takes as they are: tuples of layers. Agents and checkpoints alone need flat vectors,
layer by layer as in `shes.agents.mlp`; `flat` and `layers` convert them.

A `Replay` never changes: `append` returns another one. The two share their memory, a ring with room for one generation
beyond the capacity, so that the state of the last generation stays whole while the next one is stored.

D parameters of a network, A outputs of an actor, M transitions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import prod
from typing import Any, TypeAlias

import numpy as np

from shes.agents.mlp import MLP
from shes.baselines.learner_settings import LearnerSettings
from shes.es.statistics import ObservationStatistics
from shes.types import F32Array, F64Array

OUTPUT_RANGE = 0.003
"""Initial weights and biases of output layers are uniform in plus and minus this."""

Rows: TypeAlias = Mapping[str, F32Array]
"""Transitions: arrays [M, ...] by name."""
Network: TypeAlias = tuple[tuple[Any, Any], ...]
"""Weights [..., in, out] and biases [..., out] of each layer: arrays of NumPy, or of JAX while a level learns."""
Learner: TypeAlias = Mapping[str, Any]
"""Networks `actor` and `critics`, which are stacked on a first axis of two; `target_`, their targets; `mean_` and
`square_`, Adam's moving averages of their gradients and of the squares; `num_updates` of the critics."""


class _Ring:
    """Memory for transitions, written in a circle: the transition with number n is in row `n % length`."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], length: int, written: int) -> None:
        self.length, self.written = length, written
        self.arrays = {name: np.empty((length, *shape), np.float32) for name, shape in shapes.items()}

    def write(self, rows: Rows) -> None:
        places = (self.written + np.arange(len(rows["reward"]))) % self.length
        for name, values in rows.items():
            self.arrays[name][places] = values
        self.written += len(places)


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """The last M transitions of a level, at most `capacity`, in memory."""

    shapes: Mapping[str, tuple[int, ...]]
    """Shape of each array of a transition, by name; one is `reward`."""
    capacity: int
    slack: int
    """Number of transitions that can be appended before this buffer itself is overwritten."""
    size: int = 0
    """Number of transitions, M."""
    end: int = 0
    """Number of transitions ever appended."""
    _ring: _Ring | None = field(default=None, repr=False)

    @property
    def num_bytes(self) -> int:
        """Bytes of memory that the buffer takes once it is full."""
        return (self.capacity + self.slack) * 4 * sum(prod(shape) for shape in self.shapes.values())

    def append(self, rows: Rows) -> Replay:
        """Return the buffer with `rows` as its last transitions, without the oldest if it was full."""
        ring = self._ring
        if ring is None or ring.written != self.end:  # another buffer has gone on from this one
            ring = _Ring(self.shapes, self.capacity + self.slack, self.end - self.size)
            for part in self.parts():
                ring.write(part)
        ring.write(rows)
        size = min(self.size + ring.written - self.end, self.capacity)
        return replace(self, size=size, end=ring.written, _ring=ring)

    def sample(self, rng: np.random.Generator, *shape: int) -> dict[str, F32Array]:
        """Return transitions drawn with replacement, as arrays [*shape, ...]."""
        ring = self._intact()
        places = (self.end - self.size + rng.integers(0, self.size, shape)) % ring.length
        return {name: array[places] for name, array in ring.arrays.items()}

    def parts(self) -> tuple[Rows, Rows]:
        """Return all transitions as two blocks of views, the oldest first: to the end of the ring, and from its start.

        The division depends on the number of transitions alone, so that it is the same after a resume.
        """
        ring = self._intact() if self.size else _Ring(self.shapes, 1, 0)
        first = (self.end - self.size) % ring.length
        count = min(self.size, ring.length - first)
        blocks = slice(first, first + count), slice(self.size - count)
        older, newer = ({name: array[block] for name, array in ring.arrays.items()} for block in blocks)
        return older, newer

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the buffer as arrays by name. They are views: nothing is copied."""
        blocks = zip(("older", "newer"), self.parts(), strict=True)
        rows = {f"{part}/{name}": array for part, block in blocks for name, array in block.items()}
        return {"end": np.array(self.end), **rows}

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> Replay:
        """Return the buffer that `to_arrays` converted; raise ValueError if they are more transitions than it holds."""
        blocks = [{name: arrays[f"{part}/{name}"] for name in self.shapes} for part in ("older", "newer")]
        end, size = int(arrays["end"]), sum(len(block["reward"]) for block in blocks)
        if not size <= min(end, self.capacity):
            raise ValueError(f"a replay buffer of {self.capacity} transitions has {size}, of {end} ever made")
        return replace(self, size=0, end=end - size, _ring=None).append(blocks[0]).append(blocks[1])

    def emptied(self) -> Replay:
        """Return the buffer without its transitions."""
        return replace(self, size=0, _ring=None)

    def _intact(self) -> _Ring:
        ring = self._ring
        assert ring is not None, "an empty buffer has no transitions"
        assert ring.written - (self.end - self.size) <= ring.length, "the buffer has been overwritten"
        return ring


@dataclass(frozen=True, kw_only=True)
class Level:
    """The parts of a level that do not change."""

    name: str
    actor: MLP
    half_range: tuple[float, ...]
    """Largest absolute value of each output of the actor [A]."""
    exploration_std: F64Array
    """Standard deviation of the exploration noise on each output of the actor [A]."""
    settings: LearnerSettings
    replay: Replay
    """Its buffer before the first transition."""
    update_interval: int = 1
    """Environment steps after which the level learns again: the acting level as many times, the controller once."""

    def start(self, rng: np.random.Generator) -> LearnerState:
        """Return the state before the first transition. The action is an input of every hidden layer of a critic."""
        *sizes, actions = self.actor.sizes
        critic = [*((fan_in + actions, fan_out) for fan_in, fan_out in pairwise(sizes)), (sizes[-1], 1)]
        actor, *pair = (_initial(shapes, rng) for shapes in (pairwise(self.actor.sizes), critic, critic))
        networks = {"actor": actor, "critics": _mapped(lambda *both: np.stack(both), *pair)}
        learner: dict[str, Any] = {**networks, **{f"target_{name}": network for name, network in networks.items()}}
        for moment in ("mean", "square"):
            learner |= {f"{moment}_{name}": _mapped(np.zeros_like, network) for name, network in networks.items()}
        statistics = ObservationStatistics.empty(sizes[0])
        return LearnerState(learner={**learner, "num_updates": 0}, statistics=statistics, replay=self.replay)

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> LearnerState:
        """Return the state that `LearnerState.to_arrays` converted."""
        like = self.start(np.random.default_rng(0)).learner
        networks = {name: layers(arrays[name], own) for name, own in like.items() if name != "num_updates"}
        count, total, squares = (arrays[f"observation_{name}"] for name in ("count", "total", "total_squares"))
        return LearnerState(
            learner={**networks, "num_updates": int(arrays["num_updates"])},
            statistics=ObservationStatistics(count=int(count), total=total, total_squares=squares),
            replay=self.replay.from_arrays(within("replay", arrays)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnerState:
    """State of a level between generations."""

    learner: Learner
    """Arrays of NumPy."""
    statistics: ObservationStatistics
    """Statistics of the inputs; empty if they are not normalised."""
    replay: Replay

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the state as arrays by name."""
        return {
            **{name: flat(network) for name, network in self.learner.items() if name != "num_updates"},
            "num_updates": np.array(self.learner["num_updates"]),
            **{f"observation_{name}": np.array(value) for name, value in vars(self.statistics).items()},
            **{f"replay/{name}": array for name, array in self.replay.to_arrays().items()},
        }


def flat(network: Network) -> F32Array:
    """Return the parameters of a network as vectors [..., D]."""
    parts = [array.reshape(*layer[1].shape[:-1], -1) for layer in network for array in layer]
    return np.concatenate(parts, axis=-1)


def layers(parameters: F32Array, like: Network) -> Network:
    """Return the network of the shapes of `like` whose parameters are the vectors `parameters` [..., D], as views."""
    lead = parameters.ndim - 1
    sizes = [prod(array.shape[lead:]) for layer in like for array in layer]
    parts = iter(np.split(parameters, np.cumsum(sizes[:-1]), axis=-1))
    return _mapped(lambda array: next(parts).reshape(array.shape), like)


def within(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return those of `arrays` whose names begin with `prefix/`, without it."""
    return {name.removeprefix(f"{prefix}/"): array for name, array in arrays.items() if name.startswith(f"{prefix}/")}


def _mapped(function: Callable[..., np.ndarray], *networks: Network) -> Network:
    of_layers = (zip(*layers, strict=True) for layers in zip(*networks, strict=True))
    return tuple((function(*weights), function(*biases)) for weights, biases in of_layers)


def _initial(shapes: Iterable[tuple[int, int]], rng: np.random.Generator) -> Network:
    """Return an initial network: hidden weights are uniform in 1 / sqrt(inputs), their biases 0."""

    def uniform(limit: float, *shape: int) -> F32Array:
        return rng.uniform(-limit, limit, shape).astype(np.float32)

    *hidden, (last_in, last_out) = shapes
    first = [(uniform(fan_in**-0.5, fan_in, fan_out), np.zeros(fan_out, np.float32)) for fan_in, fan_out in hidden]
    return (*first, (uniform(OUTPUT_RANGE, last_in, last_out), uniform(OUTPUT_RANGE, last_out)))
