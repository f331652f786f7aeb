"""Where an agent goes: a map of the paths and goals of its best checkpoint, and one of its search for a way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shes.algorithms.contract import Explored
from shes.drawing.renderer import Extent, Outline, extent_of, outlines
from shes.envs.episode_batch import EpisodeBatch
from shes.training.build import build_task, open_run
from shes.training.evaluate import fresh_seeds
from shes.training.loaded_agent import Agent
from shes.types import F64Array, IntArray
from shes.viewing.curve_figures import numbers
from shes.viewing.report_page import Figure

MOST_EPISODES = 20
"""More paths would hide each other."""
_MARGIN_M = 1.0
_GROUND, _CHASM = "#e9ece7", "#a9aeb0"
_FILLS = {"wall": "#8b94a1", "platform": _GROUND, "block": "#d2a873"}
_PATH, _GOAL, _CELL = "#c2560c", "#1f5fc4", "#1f5fc459"
_CELL_HALF_M = 0.45
_HEIGHT = 560


@dataclass(frozen=True, kw_only=True)
class EpisodePath:
    """Where the robot was in one episode."""

    path: F64Array
    """Positions of the robot at its start and after each step [steps + 1, 2] in metres."""
    goals: F64Array
    """The goals in the order in which they were set [goals, 2] in metres; empty if there are none."""
    score: float


@dataclass(frozen=True, kw_only=True)
class WorldMap:
    """Episodes of an agent in its world."""

    episodes: list[EpisodePath]
    step_s: float
    outlines: list[Outline]
    """The world's boxes; none for an environment that draws itself."""
    extent: Extent
    explored: Explored | None
    """Findings of the run's search for a way at its end; None without a search."""


def play_episodes(run: Path, episodes: int, seed: int | None = None) -> WorldMap:
    """Play the first of the episodes that `evaluate` runs, at most 20, and return their paths.

    Raises:
        ConfigError: The environment does not tell the robot's position.
        ShesError: The best checkpoint of `run` cannot be played.
    """
    opened = open_run(run, device="cpu")
    seeds = fresh_seeds(opened.state, min(episodes, MOST_EPISODES), seed)
    task = build_task(opened.config, len(seeds), is_evaluation=True)
    try:
        model = None if task.draws_itself else task.world_to_draw().compile()
        agent = Agent(opened, len(seeds))
        task.reset(np.arange(len(seeds)), seeds)
        task.check_position()
        played = _play(task, agent, opened.config.evaluation_steps)
    finally:
        task.close()
    explored = opened.algorithm.explored(opened.state)
    if explored is not None and opened.folder.checkpoint_path("last").exists():
        explored = opened.algorithm.explored(open_run(run, "last", device="cpu").state)
    return WorldMap(
        episodes=played,
        step_s=task.step_s,
        outlines=[] if model is None else outlines(model),
        extent=_extent(played) if model is None else extent_of(model),
        explored=explored,
    )


def _play(task: EpisodeBatch, agent: Agent, most_steps: int) -> list[EpisodePath]:
    """Play the episodes that were reset in `task` to their ends, in lockstep."""
    active: IntArray = np.arange(task.num_episodes)
    steps, score = np.zeros(task.num_episodes, dtype=np.int64), np.zeros(task.num_episodes)
    paths, goals = [task.position.copy()], list[F64Array]()
    for _ in range(most_steps):
        control = agent.control(task.observe(), task.position, task.heading, task.goal)
        if agent.goal is not None:
            goals.append(agent.goal)
        task.step(active, control)
        paths.append(task.position.copy())
        steps[active] += 1
        score[active] = task.score[active]
        active = active[~(task.terminated | task.diverged)[active]]
        if not len(active):
            break
    path, held = np.stack(paths), np.stack(goals) if goals else np.empty((0, task.num_episodes, 2))
    is_new = np.ones(held.shape[:2], dtype=np.bool_)
    is_new[1:] = (np.diff(held, axis=0) != 0).any(axis=2)
    return [
        EpisodePath(path=path[: end + 1, i], goals=held[:end, i][is_new[:end, i]], score=float(score[i]))
        for i, end in enumerate(steps.tolist())
    ]


def _extent(episodes: list[EpisodePath]) -> Extent:
    """Return the area of all paths and goals."""
    points = np.concatenate([part for each in episodes for part in (each.path, each.goals)])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def map_figure(world: WorldMap) -> Figure:
    """Return the map of the episodes; an entry of its legend shows and hides path and goals of one."""
    data = [trace for number, each in enumerate(world.episodes) for trace in _episode_traces(number, each, world)]
    return {"data": data, "layout": _layout(world)}


def search_figure(world: WorldMap, explored: Explored) -> Figure:
    """Return the map of a search for a way: the cells reached, and the way found with its points."""
    half = _CELL_HALF_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [np.nan, np.nan]])
    squares = (explored.places[:, None] + half).reshape(-1, 2)
    way = {"mode": "lines+markers", "line": {"color": _PATH}, "name": f"way found, {len(explored.way)} points"}
    cells = {"mode": "lines", "fill": "toself", "fillcolor": _CELL, "line": {"width": 0}, "hoverinfo": "skip"}
    cells["name"] = f"{len(explored.places)} cells reached"
    return {"data": [_trace(squares, **cells), _trace(explored.way, **way)], "layout": _layout(world)}


def _episode_traces(number: int, episode: EpisodePath, world: WorldMap) -> Iterator[dict[str, Any]]:
    """Yield the path of an episode, its goals as crosses, and its end as a dot."""
    name = f"episode {number}, score {episode.score:g}"
    end = f"{name}: its end, after {(len(episode.path) - 1) * world.step_s:.1f} s"
    cross = {"color": _GOAL, "size": 6, "symbol": "x-thin", "line": {"width": 1.5, "color": _GOAL}}
    own = {"legendgroup": name, "hovertemplate": f"{name}<br>(%{{x:.1f}}, %{{y:.1f}}) m<extra></extra>"}
    yield _trace(episode.path, **own, name=name, mode="lines", line={"color": _PATH, "width": 1.5}, opacity=0.6)
    yield _trace(episode.goals, **own, mode="markers", marker=cross, showlegend=False)
    own["hovertemplate"] = f"{end}<extra></extra>"
    yield _trace(episode.path[-1:], **own, mode="markers", marker={"color": _PATH, "size": 8}, showlegend=False)


def _trace(points: F64Array, **look: Any) -> dict[str, Any]:
    return {"type": "scatter", "x": numbers(points[:, 0]), "y": numbers(points[:, 1]), **look}


def _layout(world: WorldMap) -> dict[str, Any]:
    """Return the layout of a map, with the world in it."""
    left, bottom, right, top = world.extent
    shapes = [
        {
            "type": "path",
            "path": "M" + "L".join(f"{x:.3f},{y:.3f}" for x, y in outline.corners) + "Z",
            "fillcolor": _FILLS[outline.kind],
            "line": {"width": 0},
            "layer": "below",
        }
        for outline in world.outlines
    ]
    has_platforms = any(outline.kind == "platform" for outline in world.outlines)
    return {
        "xaxis": {"range": [left, right], "title": {"text": "x in metres"}, "constrain": "domain"},
        "yaxis": {"range": [bottom, top], "title": {"text": "y in metres"}, "scaleanchor": "x", "constrain": "domain"},
        "shapes": shapes,
        "hovermode": "closest",
        "height": _HEIGHT,
        "margin": {"l": 60, "r": 20, "t": 30, "b": 50},
        "plot_bgcolor": _CHASM if has_platforms else _GROUND,
    }
