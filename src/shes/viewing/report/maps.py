"""Where an agent goes: the paths and goals of episodes of its best checkpoint, and a map of them over the world."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shes.algorithms.contract import Explored
from shes.drawing.plan import Outline, Plan, plan_of
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import Marker
from shes.runs.build import build_task, open_run
from shes.runs.evaluate import fresh_seeds
from shes.runs.loaded_agent import Agent
from shes.types import F64Array, IntArray
from shes.viewing.report.curve_charts import Figure, numbers

MOST_EPISODES = 20
"""More paths would hide each other."""
_MARGIN_M = 1.0
_FILLS = {"wall": "--wall", "platform": "--ground", "block": "--block"}
_LEAST_MARKER_M = 0.2


@dataclass(frozen=True, kw_only=True)
class PlayedEpisode:
    """The path of one episode."""

    path: F64Array
    """Positions of the robot at its start and after each step [steps + 1, 2] in metres."""
    goals: F64Array
    """The goals in the order in which they were set [goals, 2] in metres; empty if there are none."""
    goal_steps: list[int]
    """Steps before which they were set [goals]."""
    score: float
    markers: list[Marker]
    """The task's markers at its start."""


@dataclass(frozen=True, kw_only=True)
class Journeys:
    """Episodes of an agent in its world."""

    episodes: list[PlayedEpisode]
    step_s: float
    plan: Plan | None
    """The world; None for an environment that draws itself."""
    explored: Explored | None = None
    """Findings of the run's search for a way at its end; None without a search."""


def play_episodes(run: Path, episodes: int, seed: int | None = None) -> Journeys:
    """Play the first of the episodes that `evaluate` runs, at most 20, and return their paths.

    Raises:
        ConfigError: The environment does not tell the robot's position.
        ShesError: Raised by `open_run`.
    """
    opened = open_run(run, device="cpu")
    seeds = fresh_seeds(opened.state, min(episodes, MOST_EPISODES), seed)
    task = build_task(opened.config, len(seeds), is_evaluation=True)
    try:
        plan = None if task.draws_itself else plan_of(task.world_to_draw().compile())
        agent = Agent(opened, len(seeds))
        task.reset(np.arange(len(seeds)), seeds)
        task.check_position()
        played = _play(task, agent, opened.config.evaluation_steps)
    finally:
        task.close()
    explored = opened.algorithm.explored(opened.state)
    if explored is not None and opened.folder.checkpoint_path("last").exists():
        explored = opened.algorithm.explored(open_run(run, "last", device="cpu").state)
    return Journeys(episodes=played, step_s=task.step_s, plan=plan, explored=explored)


def _play(task: EpisodeBatch, agent: Agent, most_steps: int) -> list[PlayedEpisode]:
    """Play the episodes that were reset in `task` to their ends, in lockstep."""
    active: IntArray = np.arange(task.num_episodes)
    markers = [task.markers(episode) for episode in range(task.num_episodes)]
    steps, score = np.zeros(task.num_episodes, dtype=np.int64), np.zeros(task.num_episodes)
    paths, goals = [task.position.copy()], list[F64Array]()
    for _ in range(most_steps):
        control = agent.control(task.observe(), task.position, task.heading, task.goal)
        held = agent.goal
        if held is not None:
            goals.append(held)
        task.step(active, control)
        paths.append(task.position.copy())
        steps[active] += 1
        score[active] = task.score[active]
        active = active[~(task.terminated | task.diverged)[active]]
        if not len(active):
            break
    held_goals = np.stack(goals) if goals else np.empty((0, task.num_episodes, 2))
    return [
        _episode(np.stack(paths)[: end + 1, i], held_goals[:end, i], float(score[i]), markers[i])
        for i, end in enumerate(steps.tolist())
    ]


def _episode(path: F64Array, held: F64Array, score: float, markers: list[Marker]) -> PlayedEpisode:
    """Return an episode whose goals [T, 2] were `held`."""
    is_new = np.ones(len(held), dtype=np.bool_)
    is_new[1:] = (np.abs(np.diff(held, axis=0)) > 0).any(axis=1)
    first = np.flatnonzero(is_new)
    return PlayedEpisode(path=path, goals=held[first], goal_steps=first.tolist(), score=score, markers=markers)


def map_figure(journeys: Journeys) -> Figure:
    """Return the map: the world, and of each episode its path, its goals, and what the task marks."""
    data = [trace for number, each in enumerate(journeys.episodes) for trace in _episode_traces(number, each, journeys)]
    return {"data": data, "layout": _layout(journeys)}


def search_figure(explored: Explored, journeys: Journeys) -> Figure:
    """Return the map of a search for a way: the places reached, and the way found with its points."""
    layout = _layout(journeys)
    half = np.array([[-0.45, -0.45], [0.45, -0.45], [0.45, 0.45], [-0.45, 0.45], [np.nan, np.nan]])
    squares = (explored.places[:, None] + half).reshape(-1, 2)
    way = explored.way
    line = {"type": "scatter", "mode": "lines", "hoverinfo": "skip"}
    return {
        "data": [
            {**line, **_xy(squares), "fill": "toself", "fillcolor": "--goal/0.35", "line": {"width": 0}},
            {**line, **_xy(way), "line": {"color": "--path", "width": 1.5}},
            {
                "type": "scatter",
                "mode": "markers",
                **_xy(way),
                "marker": {"color": "--path", "size": 6},
                "hovertemplate": "waypoint (%{x:.1f}, %{y:.1f}) m<extra></extra>",
            },
        ],
        "layout": layout,
    }


def _xy(points: F64Array) -> dict[str, Any]:
    return {"x": numbers(points[:, 0]), "y": numbers(points[:, 1])}


def _layout(journeys: Journeys) -> dict[str, Any]:
    """Return the layout of a map, with the world in it."""
    left, bottom, right, top = _extent(journeys)
    shapes = [] if journeys.plan is None else _world_shapes(journeys.plan)
    return {
        "xaxis": {"range": [left, right], "title": {"text": "x in metres"}, "constrain": "domain"},
        "yaxis": {"range": [bottom, top], "title": {"text": "y in metres"}, "scaleanchor": "x", "constrain": "domain"},
        "shapes": shapes,
        "hovermode": "closest",
        "plot_bgcolor": "--chasm" if any(shape["fillcolor"] == _FILLS["platform"] for shape in shapes) else "--ground",
    }


def _extent(journeys: Journeys) -> tuple[float, float, float, float]:
    """Return the area shown: that of the world, else that of all paths and goals."""
    if journeys.plan is not None:
        return journeys.plan.extent
    points = np.concatenate([part for each in journeys.episodes for part in (each.path, each.goals)])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _world_shapes(plan: Plan) -> list[dict[str, Any]]:
    def shape(outline: Outline) -> dict[str, Any]:
        path = "L".join(f"{x:.3f},{y:.3f}" for x, y in outline.corners)
        line = {"width": 0}
        return {"type": "path", "path": f"M{path}Z", "fillcolor": _FILLS[outline.kind], "line": line, "layer": "below"}

    return [shape(outline) for outline in plan.outlines]


def _episode_traces(number: int, episode: PlayedEpisode, journeys: Journeys) -> Iterator[dict[str, Any]]:
    """Yield the traces of an episode, whose markers are shown only if it is chosen alone."""
    seconds = np.arange(len(episode.path)) * journeys.step_s
    common = {"type": "scatter", "meta": {"episode": number, "alone": False}}
    name = f"episode {number}, score {episode.score:g}"
    for marker in episode.markers:
        yield {"type": "scatter", "meta": {"episode": number, "alone": True}, **_marker_trace(marker)}
    yield {
        **common,
        "mode": "lines",
        "name": name,
        "x": numbers(episode.path[:, 0]),
        "y": numbers(episode.path[:, 1]),
        "customdata": numbers(seconds),
        "line": {"color": "--path", "width": 1.5},
        "opacity": 0.6,
        "hovertemplate": f"{name}<br>%{{customdata:.1f}} s at (%{{x:.1f}}, %{{y:.1f}}) m<extra></extra>",
    }
    if len(episode.goals):
        yield {
            **common,
            "mode": "markers",
            "name": f"goals of episode {number}",
            "x": numbers(episode.goals[:, 0]),
            "y": numbers(episode.goals[:, 1]),
            "customdata": numbers(seconds[episode.goal_steps]),
            "marker": {"color": "--goal", "size": 6, "symbol": "x-thin", "line": {"width": 1.5, "color": "--goal"}},
            "hovertemplate": f"goal of episode {number}, set at %{{customdata:.1f}} s<br>"
            "(%{x:.1f}, %{y:.1f}) m<extra></extra>",
        }
    yield {
        **common,
        "mode": "markers",
        "x": numbers(episode.path[-1:, 0]),
        "y": numbers(episode.path[-1:, 1]),
        "marker": {"color": "--path", "size": 8},
        "hovertemplate": f"{name}: its end, after {seconds[-1]:.1f} s<extra></extra>",
    }


def _marker_trace(marker: Marker) -> dict[str, Any]:
    """Return the outline of a marker, to scale."""
    angle = np.linspace(0, 2 * np.pi, 33)
    radius = max(marker.radius, _LEAST_MARKER_M)
    red, green, blue, opacity = marker.color
    color = f"rgba({255 * red:.0f},{255 * green:.0f},{255 * blue:.0f},{opacity:.2f})"
    return {
        "mode": "lines",
        "x": numbers(marker.position[0] + radius * np.cos(angle)),
        "y": numbers(marker.position[1] + radius * np.sin(angle)),
        "fill": "toself",
        "fillcolor": color,
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def episode_names(journeys: Journeys) -> Sequence[str]:
    """Return the name of each episode, with its score."""
    return [f"episode {number}, score {each.score:g}" for number, each in enumerate(journeys.episodes)]
