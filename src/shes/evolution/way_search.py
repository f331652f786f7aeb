"""The search for a way to the target by going back: the mean primitive walks from places where it has been.

It asks for a simulator that can be put back into a state, and for nothing else: neither reward nor map nor target
direct it. Once a way is known, half of the walkers shorten it. Everything is decided here, in the parent process;
workers run episodes of one decision.

Source: Ecoffet et al. 2021 (Go-Explore); `docs/learning.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shes.backends.backend import Backend
from shes.es.level import LevelParameters
from shes.evolution.state import PATIENCE, Archive, TrainState
from shes.rollout.episodes import EpisodeTask, Generation, Snapshot, wander
from shes.rollout.roll_out import roll_out_tasks
from shes.streams import Purpose, stream
from shes.types import BoolArray, F64Array, IntArray

WALKERS = 64
FOLLOWERS = 32
"""Walkers that begin on the way, once one is known, and take short cuts."""
MAX_PACE = 3.0
"""Most decisions' worth of the way that a follower tries to cover with one decision."""
SLICE_STEPS = 32_000
"""Environment steps of a slice of the search, at least."""
REST = 5
"""Generations from slice to slice of a search that has stalled."""
SLICES = 10
"""Slices in a generation in which nothing else can be learned, until a way is known."""
_DECISIONS = 5


@dataclass(frozen=True, kw_only=True)
class WaySearch:
    """A search in the environment of a run."""

    decode: Callable[[F64Array], tuple[IntArray, F64Array, BoolArray, BoolArray]]
    """Returns cells [N, K], positions [N, X], and whether robots are upright and have succeeded [N], by state."""
    start: Archive
    interval: int
    """Control steps of a decision."""
    horizon: int
    """Most control steps from the reset to a place."""
    goal_distance: float
    """Distance of the primitive's goals in metres."""
    primitive_learns: bool
    """Whether the primitive learns to walk faster: then a stalled search goes on in every `REST`-th generation."""


def explore(state: TrainState, search: WaySearch | None, backend: Backend) -> TrainState:
    """Return `state` after more of the search, which its environment steps include."""
    before = state.archive
    if search is None or before is None or before.is_over or (before.stalled >= PATIENCE and state.generation % REST):
        return state
    archive, rng = before, stream(state.seed, Purpose.ARCHIVE, state.generation)
    mean = (LevelParameters.of(state.levels[-1].theta, state.levels[-1].statistics),)
    walk = Generation(levels=mean, sigma=0, episodes_per_policy=1, kind="exploration", branch_steps=search.interval)
    for _ in range(1 if search.primitive_learns else SLICES):
        last_step = archive.env_steps + SLICE_STEPS
        while archive.env_steps < last_step:
            archive = _walk(archive, search, walk, rng, backend)
        archive = archive.after_slice(goes_on=search.primitive_learns)
        if archive.way_steps:
            break
    return replace(state, archive=archive, env_steps=state.env_steps + archive.env_steps - before.env_steps)


def _walk(
    archive: Archive, search: WaySearch, generation: Generation, rng: np.random.Generator, backend: Backend
) -> Archive:
    """Return the archive after a few decisions of walkers that begin in its cells."""
    decisions = min(_DECISIONS, search.horizon // search.interval)
    last_step, aims = search.horizon - decisions * search.interval, np.zeros((decisions, 0, 2))
    cells = archive.choose(rng, WALKERS, last_step)
    if archive.way_steps:
        cells[:FOLLOWERS], passed = archive.choose_on_way(rng, FOLLOWERS, last_step)
        ahead = np.ceil(np.outer(np.arange(1, decisions + 1), rng.uniform(1, MAX_PACE, FOLLOWERS)))
        aims = archive.way[np.minimum(passed + ahead.astype(np.int64), len(archive.way) - 1), :2]
    archive = replace(archive, chosen=archive.chosen + np.bincount(cells, minlength=len(archive.nodes)))
    steps = archive.steps[cells].tolist()
    starts = [Snapshot(state=archive.states[i] if n else None, steps=n) for i, n in zip(cells, steps, strict=True)]
    walkers, nodes = np.arange(WALKERS), archive.nodes[cells]
    for angle, aim in zip(wander(rng, decisions, WALKERS), aims, strict=True):
        x, y = (aim - archive.positions[nodes[: len(aim)], :2]).T
        angle[: len(aim)] = np.arctan2(y, x)
        goals = search.goal_distance * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        seeds = rng.integers(0, 2**63, WALKERS).tolist()
        tasks = [
            EpisodeTask(
                member=walker,
                noise_index=(0,),
                signs=((0,),),
                slots=(0,),
                seeds=(seeds[walker],),
                records_statistics=False,
                start=replace(start, goals=goals[walker : walker + 1]),
                kept_slot=0,
            )
            for walker, start in zip(walkers.tolist(), starts, strict=True)
        ]
        results = roll_out_tasks(tasks, generation, backend)
        archive = replace(archive, env_steps=archive.env_steps + int(results.steps.sum()))
        walkers = walkers[[(walker, 0) in results.snapshots for walker in walkers.tolist()]]
        if not len(walkers):
            break
        starts = [results.snapshots[walker, 0][0] for walker in walkers.tolist()]
        states, steps = np.stack([np.asarray(each.state) for each in starts]), np.array([each.steps for each in starts])
        places, positions, up, is_success = search.decode(states)
        new = {"parents": nodes[walkers], "positions": positions, "places": places}
        nodes[walkers] = len(archive.parents) + np.arange(len(walkers))
        archive = replace(archive, **{name: np.concatenate([getattr(archive, name), new[name]]) for name in new})
        archive = archive.entered(states[up], steps[up], nodes[walkers][up], is_success=is_success[up])
    return archive
