"""The state of a run between generations, and its conversion to and from the named arrays of a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from shes.es.level import LevelState, StrategyState
from shes.es.optimizers import OptimizerState
from shes.es.statistics import ObservationStatistics
from shes.rollout.episodes import Snapshot
from shes.types import BoolArray, F64Array, IntArray

PATIENCE = 5
"""The search has stalled if this many slices have not shortened the way."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Archive:
    """The places that a search for a way has reached, how to get back to each, and the best way so far.

    A place is a cell of the task's own coordinates. Ways form a tree of nodes, the positions at the decisions.
    C cells, N nodes, W nodes of the way, M walkers, K coordinates of a cell, S of a physics state, X of a position.

    Source: Ecoffet et al. 2021 (Go-Explore).
    Deviation: nothing but the time to get there makes a cell better.
    """

    states: F64Array
    """Physics state in each cell [C, S], ignored for the reset; empty [0, S] once the search is over."""
    steps: IntArray
    """Control steps from the reset to each cell [C]; 0 for the reset alone."""
    chosen: IntArray
    """Number of walkers that began in each cell [C]."""
    nodes: IntArray
    """Node of each cell [C]; that of the reset among them."""
    parents: IntArray
    """Node before each node [N]; node 0 is the reset, and its own parent."""
    positions: F64Array
    """Position of the robot, and of a block that the way leads, at each node [N, X] in metres."""
    places: IntArray
    """Cell in which each node lies [N, K]."""
    way_nodes: IntArray
    """Nodes from the reset to the shortest success [W]; empty until a way is known."""
    starts: F64Array
    """Physics states of the cells on the way, in which episodes of training may begin; empty without a way."""
    way_steps: int = 0
    """Control steps of the way; 0 until one is known."""
    stalled: int = 0
    """Slices of the search since the way has become shorter."""
    env_steps: int = 0
    """Environment steps of the search so far."""

    @classmethod
    def start(cls, cell: IntArray, position: F64Array, state_size: int) -> Archive:
        """Return the archive of a reset, of which the cell [1, K] and the position [1, X] are given."""
        zero = np.zeros(1, dtype=np.int64)
        return cls(
            states=np.zeros((1, state_size)),
            steps=zero,
            chosen=zero,
            nodes=zero,
            parents=zero,
            positions=position,
            places=cell,
            way_nodes=zero[:0],
            starts=np.zeros((0, state_size)),
        )

    @property
    def is_over(self) -> bool:
        """Whether the search is over, and the states are gone."""
        return not len(self.states)

    @property
    def cells(self) -> IntArray:
        """The cells [C, K]."""
        return self.places[self.nodes]

    @property
    def way(self) -> F64Array:
        """Positions [W, X] at the decisions from the reset to the shortest success."""
        return self.positions[self.way_nodes]

    @property
    def cells_on_way(self) -> IntArray:
        """The cell in which each point of the way but the last lies [W - 1]; -1 where nobody stood."""
        cell = {tuple(place): i for i, place in enumerate(self.cells.tolist())}
        return np.array([cell.get(tuple(place), -1) for place in self.places[self.way_nodes[:-1]].tolist()], np.int64)

    def choose(self, rng: np.random.Generator, number: int, last_step: int) -> IntArray:
        """Return the cells [number] of walkers, among those reached by step `last_step`, with repetition.

        The weight of a cell is 1 / sqrt(1 + times chosen).
        """
        weights = np.where(self.steps <= last_step, 1 / np.sqrt(1 + self.chosen), 0.0)
        return rng.choice(len(weights), number, p=weights / weights.sum())

    def choose_on_way(self, rng: np.random.Generator, number: int, last_step: int) -> tuple[IntArray, IntArray]:
        """Return cells [number] of random points of the way, as `choose`, and the numbers [number] of these points."""
        passed = self.cells_on_way
        early = np.flatnonzero((passed >= 0) & (self.steps[passed] <= last_step))
        numbers = early[rng.integers(len(early), size=number)]
        return passed[numbers], numbers

    def entered(self, states: F64Array, steps: IntArray, nodes: IntArray, *, is_success: BoolArray) -> Archive:
        """Return the archive with places where walkers are: new cells, cells reached in fewer steps, and the way.

        Of each of M walkers, the physics `states` [M, S], control `steps` since the reset, `nodes`, and whether the
        task is solved there are given.
        """
        all_nodes = np.concatenate([self.nodes, nodes])
        found, cell = np.unique(self.places[all_nodes], axis=0, return_inverse=True)
        cell, all_steps = cell.reshape(-1), np.concatenate([self.steps, steps])
        order = np.lexsort((all_steps, cell))  # stable: of equal steps the earlier one stays
        best = order[np.searchsorted(cell[order], np.arange(len(found)))]
        chosen = np.zeros(len(found), dtype=np.int64)
        chosen[cell[: len(self.nodes)]] = self.chosen
        grown = replace(
            self,
            states=np.concatenate([self.states, states])[best],
            steps=all_steps[best],
            chosen=chosen,
            nodes=all_nodes[best],
        )
        shortest = int(np.where(is_success, steps, np.iinfo(np.int64).max).argmin()) if is_success.any() else None
        if shortest is None or 0 < self.way_steps <= steps[shortest]:
            return grown
        way = [int(nodes[shortest])]
        while way[-1]:
            way.append(int(self.parents[way[-1]]))
        return replace(grown, way_nodes=np.array(way[::-1]), way_steps=int(steps[shortest]), stalled=-1)

    def after_slice(self, *, goes_on: bool = False) -> Archive:
        """Return the archive after a slice: without nodes that lead nowhere; if the search is over, without states."""
        is_used = np.zeros(len(self.parents), dtype=np.bool_)
        is_used[0], ends = True, np.concatenate([self.nodes, self.way_nodes])
        while len(ends := ends[~is_used[ends]]):
            is_used[ends] = True
            ends = self.parents[ends]
        number = np.cumsum(is_used) - 1
        # `entered` sets -1, so that the slice that has shortened the way does not count.
        stalled, parents = self.stalled + 1 if self.way_steps else 0, number[self.parents[is_used]]
        used = {name: getattr(self, name)[is_used] for name in ("positions", "places")}
        used |= {name: number[getattr(self, name)] for name in ("nodes", "way_nodes")}
        cells = np.unique(self.cells_on_way)
        starts = self.states[cells[(cells >= 0) & (self.steps[cells] > 0) & (self.steps[cells] < self.way_steps)]]
        after = replace(self, **used, parents=parents, stalled=stalled, starts=starts)
        return replace(after, states=self.states[:0]) if stalled >= PATIENCE and not goes_on else after

    def news(self, before: Archive) -> list[str]:
        """Return in words what has happened since `before`."""
        news = {
            "the search for a way begins": len(self.cells) > len(before.cells) == 1,
            f"a way of {self.way_steps} steps is known after {self.env_steps:,} environment steps of search": (
                self.way_steps and not before.way_steps
            ),
            f"the search is over: the way has {self.way_steps} steps": self.is_over and not before.is_over,
        }
        return [line for line, has_happened in news.items() if has_happened]


@dataclass(frozen=True, kw_only=True)
class TrainState(StrategyState):
    """State of a run between generations."""

    env_steps: int = 0
    """Number of environment steps of training so far."""
    archive: Archive | None = None
    """State of the search for a way, if enabled."""
    running: tuple[Snapshot | None, ...] | None = None
    """Episodes that continue in the next generation, from which pairs of primitives branch off; None for a new one."""


_COUNTS = ("seed", "generation", "env_steps")
_RUNNING: dict[str, np.ndarray] = {"running/states": np.zeros((0, 0)), "running/steps": np.zeros(0, np.int64)}
"""Arrays of no episodes that continue. They are missing before the first generation."""
_ARCHIVE = {f"archive/{field.name}": field.name for field in fields(Archive)}
"""Arrays of the search for a way, which grow."""


def to_arrays(state: TrainState) -> dict[str, np.ndarray]:
    """Return `state` as arrays by name."""
    arrays: dict[str, Any] = {name: np.int64(getattr(state, name)) for name in _COUNTS}
    arrays["levels"] = [level.name for level in state.levels]
    for level in state.levels:
        arrays |= {
            f"{level.name}/theta": level.theta,
            f"{level.name}/optimizer_steps": np.int64(level.optimizer.steps),
            **{f"{level.name}/optimizer_{slot}": values for slot, values in level.optimizer.slots.items()},
            **{f"{level.name}/observation_{name}": value for name, value in vars(level.statistics).items()},
        }
    if state.archive is not None:
        arrays |= {name: getattr(state.archive, field) for name, field in _ARCHIVE.items()}
    if state.running is not None:
        size = next(len(end.state) for end in state.running if end is not None and end.state is not None)
        states = [np.zeros(size) if end is None else end.state for end in state.running]
        steps = [-1 if end is None else end.steps for end in state.running]
        arrays |= {"running/states": states, "running/steps": steps}
    return {name: np.asarray(value) for name, value in arrays.items()}


def from_arrays(arrays: Mapping[str, np.ndarray]) -> TrainState:
    """Return the state that `to_arrays` converted."""
    running = archive = None
    if "archive/nodes" in arrays:
        found: dict[str, Any] = {field: arrays[name] for name, field in _ARCHIVE.items()}
        archive = Archive(**{field: array if array.ndim else array.item() for field, array in found.items()})
    if "running/states" in arrays:
        ends = zip(arrays["running/states"], arrays["running/steps"].tolist(), strict=True)
        running = tuple(None if steps < 0 else Snapshot(state=own, steps=steps) for own, steps in ends)
    counts = {name: int(arrays[name]) for name in _COUNTS}
    levels = tuple(_level(arrays, str(name)) for name in arrays["levels"])
    return TrainState(**counts, levels=levels, archive=archive, running=running)


def _level(arrays: Mapping[str, np.ndarray], name: str) -> LevelState:
    own = {key.removeprefix(f"{name}/"): values for key, values in arrays.items() if key.startswith(f"{name}/")}
    theta, steps, count = own.pop("theta"), int(own.pop("optimizer_steps")), int(own.pop("observation_count"))
    sums = {sums: own.pop(f"observation_{sums}") for sums in ("total", "total_squares")}
    slots = {key.removeprefix("optimizer_"): values for key, values in own.items()}
    optimizer, statistics = OptimizerState(steps=steps, slots=slots), ObservationStatistics(count=count, **sums)
    return LevelState(name=name, theta=theta, optimizer=optimizer, statistics=statistics)


def arrays_like(arrays: Mapping[str, np.ndarray], start: TrainState) -> dict[str, np.ndarray]:
    """Return what `arrays` of a run begun by `start` have to be like; see `check_arrays`."""
    first = to_arrays(start)
    growing = {name: first[name][:0] for name in _ARCHIVE.keys() & first.keys() if first[name].ndim}
    return first | growing | (_RUNNING if arrays.keys() & _RUNNING.keys() else {})
