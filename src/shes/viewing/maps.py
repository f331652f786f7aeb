"""Where an agent goes: a map of the paths and goals of its best checkpoint, and one of its search for a way."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shes.algorithms.contract import Explored
from shes.drawing.renderer import Extent, Outline, extent_of, outlines
from shes.runs.build import open_run
from shes.runs.folder import RunFolder
from shes.types import F64Array
from shes.viewing.curve_figures import numbers
from shes.viewing.playback import Playback
from shes.viewing.report_page import Figure

MOST_EPISODES = 10
"""More paths would hide each other."""
_GROUND, _CHASM = "#e9ece7", "#a9aeb0"
_FILLS = {"wall": "#8b94a1", "platform": _GROUND, "block": "#d2a873"}
_PATH, _GOAL, _CELL = "#c2560c", "#1f5fc4", "#1f5fc459"
_CELL_HALF_M = 0.45
_HEIGHT = 560


class EpisodePath(NamedTuple):
    """Where the robot was in one episode."""

    path: F64Array
    """Positions of the robot at its start and after each step [steps + 1, 2] in metres."""
    goals: F64Array
    """The goals in the order in which they were set [goals, 2] in metres; empty if there are none."""
    score: float


class WorldMap(NamedTuple):
    """Episodes of an agent in its world."""

    episodes: list[EpisodePath]
    step_s: float
    outlines: list[Outline]
    """The world's boxes; none for an environment that draws itself."""
    extent: Extent | None
    """Area of the world; None for an environment that draws itself."""
    explored: Explored | None
    """Findings of the run's search for a way at its end; None without a search."""


def play_episodes(run: Path, episodes: int, seed: int | None = None) -> WorldMap:
    """Play the first of the episodes that `evaluate` runs, at most `MOST_EPISODES`, and return their paths."""
    playback = Playback(run, "best", seed)
    task = playback.task
    try:
        model = None if task.draws_itself else task.world_to_draw().compile()
        played = [_played(playback, playback.seed_of(number)) for number in range(min(episodes, MOST_EPISODES))]
    finally:
        task.close()
    boxes, extent = ([], None) if model is None else (outlines(model), extent_of(model))
    has_last = RunFolder.open(run).checkpoint_path("last").exists()
    opened = open_run(run, "last" if has_last else "best", device="cpu")
    return WorldMap(played, task.step_s, boxes, extent, opened.algorithm.explored(opened.state))


def _played(playback: Playback, seed: int) -> EpisodePath:
    """Play an episode; raise ConfigError if the environment does not tell the robot's position."""
    task, path, goals = playback.task, list[F64Array](), list[F64Array]()
    for _ in playback.play(seed):
        task.check_position()
        path.append(task.position[0].copy())
        if playback.goal is not None and (not goals or (goals[-1] != playback.goal).any()):
            goals.append(playback.goal.copy())
    return EpisodePath(np.stack(path), np.reshape(goals, (-1, 2)), float(task.score[0]))


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
    left, bottom, right, top = world.extent or (None,) * 4
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
