"""The archive of a search for a way: the places that were reached, how to get back to each, and the best way so far.

A place is a cell of the task's own coordinates. Ways form a tree of nodes, the robot's positions at the decisions.
C cells, N nodes, W points of the way, M walkers, K coordinates of a cell, S of a physics state, X of a position.

Source: Ecoffet et al. 2021 (Go-Explore).
Deviation: nothing but the time to get there makes a cell better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shes.types import BoolArray, F64Array, IntArray

PATIENCE = 5
"""The search is over if this many slices have not shortened the way."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Archive:
    """State of a search between generations. Every array has its own first axis, so that it can grow."""

    cells: IntArray
    """Cells [C, K]; that of the reset among them."""
    states: F64Array
    """Physics state in each cell [C, S], ignored for the reset; empty [0, S] once the search is over."""
    steps: IntArray
    """Control steps from the reset to each cell [C]; 0 for the reset alone."""
    chosen: IntArray
    """Number of walkers that began in each cell [C]."""
    nodes: IntArray
    """Node of each cell [C]."""
    parents: IntArray
    """Node before each node [N]; node 0 is the reset, and its own parent."""
    positions: F64Array
    """Robot's position at each node [N, X] in metres."""
    way: F64Array
    """Positions [W, X] from the reset to the first success; empty until a way is known."""
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
            cells=cell,
            states=np.zeros((1, state_size)),
            steps=zero,
            chosen=zero,
            nodes=zero,
            parents=zero,
            positions=position,
            way=np.zeros((0, position.shape[1])),
        )

    @property
    def is_over(self) -> bool:
        """Whether the search is over, and the states are gone."""
        return not len(self.states)

    def over(self) -> Archive:
        """Return the archive of a search that is over."""
        return replace(self, states=self.states[:0])

    @property
    def has_begun(self) -> bool:
        """Whether any place but the reset is known."""
        return len(self.cells) > 1

    def choose(self, rng: np.random.Generator, number: int, last_step: int) -> IntArray:
        """Return the cells [number] of walkers, among those reached by step `last_step`, with repetition.

        The weight of a cell is 1 / sqrt(1 + times chosen).
        """
        weights = np.where(self.steps <= max(last_step, 0), 1 / np.sqrt(1 + self.chosen), 0.0)
        return rng.choice(len(weights), number, p=weights / weights.sum())

    def grown(self, parents: IntArray, positions: F64Array) -> Archive:
        """Return the archive with more nodes."""
        parents, positions = np.concatenate([self.parents, parents]), np.concatenate([self.positions, positions])
        return replace(self, parents=parents, positions=positions)

    def entered(
        self, cells: IntArray, states: F64Array, steps: IntArray, nodes: IntArray, *, is_success: BoolArray
    ) -> Archive:
        """Return the archive with places where walkers are: new cells, cells reached in fewer steps, and the way.

        Args:
            cells: Cells [M, K].
            states: Physics states [M, S].
            steps: Control steps since the reset [M].
            nodes: Nodes [M].
            is_success: Whether the task is solved there [M].
        """
        found, cell = np.unique(np.concatenate([self.cells, cells]), axis=0, return_inverse=True)
        cell, all_steps = cell.reshape(-1), np.concatenate([self.steps, steps])
        order = np.lexsort((all_steps, cell))  # stable: of equal steps the earlier one stays
        best = order[np.searchsorted(cell[order], np.arange(len(found)))]
        chosen = np.zeros(len(found), dtype=np.int64)
        chosen[cell[: len(self.cells)]] = self.chosen
        grown = replace(
            self,
            cells=found,
            states=np.concatenate([self.states, states])[best],
            steps=all_steps[best],
            chosen=chosen,
            nodes=np.concatenate([self.nodes, nodes])[best],
        )
        shortest = int(np.where(is_success, steps, np.iinfo(np.int64).max).argmin()) if is_success.any() else None
        if shortest is None or 0 < self.way_steps <= steps[shortest]:
            return grown
        way = [int(nodes[shortest])]
        while way[-1]:
            way.append(int(self.parents[way[-1]]))
        return replace(grown, way=self.positions[way[::-1]], way_steps=int(steps[shortest]), stalled=-1)

    def after_slice(self) -> Archive:
        """Return the archive after a slice of the search: without nodes that lead nowhere, or without states.

        The slice that has shortened the way does not count as stalled.
        """
        is_used = np.zeros(len(self.parents), dtype=np.bool_)
        is_used[0], ends = True, self.nodes
        while len(ends := ends[~is_used[ends]]):
            is_used[ends] = True
            ends = self.parents[ends]
        number = np.cumsum(is_used) - 1
        stalled, parents = self.stalled + 1 if self.way_steps else 0, number[self.parents[is_used]]
        used = {"nodes": number[self.nodes], "parents": parents, "positions": self.positions[is_used]}
        after = replace(self, **used, stalled=stalled)
        return after.over() if stalled >= PATIENCE else after

    def news(self, before: Archive) -> list[str]:
        """Return in words what has happened since `before`."""
        news = {
            "the primitive walks: the search for a way begins": self.has_begun and not before.has_begun,
            f"a way of {self.way_steps} steps is known after {self.env_steps:,} environment steps of search": (
                self.way_steps and not before.way_steps
            ),
            f"the search is over: the way has {self.way_steps} steps": self.is_over and not before.is_over,
        }
        return [line for line, has_happened in news.items() if has_happened]

    @property
    def waypoints(self) -> F64Array | None:
        """The way [points, X] without its start, in metres; None until one is known.

        Every decision is a point: a line between distant points may lead through a wall.
        """
        return self.way[1:] if len(self.way) else None
