"""The map of a report: paths and goals of the episodes that evaluate runs, over the world."""

import json

import gymnasium
import numpy as np
import pytest

from shes.algorithms.contract import Explored
from shes.errors import ConfigError
from shes.runs.evaluate import evaluate
from shes.viewing.playback import Playback
from shes.viewing.report.maps import MOST_EPISODES, episode_names, map_figure, play_episodes, search_figure
from tests.e2e import runs


def test_the_episodes_are_those_that_evaluate_runs(tiny_run):
    journeys = play_episodes(tiny_run, 3)
    found = evaluate(tiny_run, episodes=3, num_workers=1)
    assert [each.score for each in journeys.episodes] == found.scores.tolist()
    assert [len(each.path) - 1 for each in journeys.episodes] == found.steps.tolist()


def test_the_path_is_where_the_robot_was(tiny_run):
    journeys = play_episodes(tiny_run, 2)
    playback = Playback(tiny_run, "best")
    for number, episode in enumerate(journeys.episodes):
        poses = np.array([moment.pose[:2] for moment in playback.play(playback.seed_of(number))])
        np.testing.assert_allclose(episode.path, poses, atol=1e-9)
    playback.task.close()


def test_each_goal_appears_once_when_it_is_set(kinds, tmp_path):
    path = runs.train_tiny(tmp_path / "run", generations=1, controller_interval=6)
    for episode in play_episodes(path, 2).episodes:
        assert episode.goal_steps == [0, 6, 12, 18]
        assert episode.goals.shape == (4, 2)
    flat = play_episodes(kinds["flat"], 2)
    assert all(episode.goals.shape == (0, 2) for episode in flat.episodes)
    flags = play_episodes(kinds["flag"], 2)  # the environment sets them
    assert all(len(episode.goals) >= 1 for episode in flags.episodes)


def test_no_more_episodes_than_can_be_seen(tiny_run):
    assert len(play_episodes(tiny_run, 10**12).episodes) == MOST_EPISODES


def test_the_map_is_drawn_to_scale(tmp_path):
    path = runs.train_tiny(tmp_path / "run", "point-push", generations=1)
    figure = map_figure(play_episodes(path, 2))
    shapes = figure["layout"]["shapes"]
    assert [shape["fillcolor"] for shape in shapes].count("--block") == 1
    assert [shape["path"] for shape in shapes if shape["fillcolor"] == "--block"] == [
        "M-4.000,4.000L4.000,4.000L4.000,12.000L-4.000,12.000Z"
    ]
    assert figure["layout"]["xaxis"]["range"] == [-13, 13]
    assert figure["layout"]["yaxis"]["scaleanchor"] == "x"
    json.dumps(figure, allow_nan=False)


def test_the_marks_of_a_task_are_shown_with_a_single_episode(tiny_run):
    journeys = play_episodes(tiny_run, 2)
    traces = map_figure(journeys)["data"]
    alone = [trace for trace in traces if trace["meta"]["alone"]]
    assert len(alone) == 2 * 16  # food and poison
    assert {trace["meta"]["episode"] for trace in traces} == {0, 1}
    assert episode_names(journeys)[1] == f"episode 1, score {journeys.episodes[1].score:g}"


def test_the_map_of_a_search_shows_places_and_the_way(tmp_path):
    settings = {"explore": "archive", "primitive_view": "egocentric", "controller_interval": 25}
    journeys = play_episodes(runs.train_tiny(tmp_path / "run", "point-push", generations=1, **settings), 2)
    assert [0, 0] in journeys.explored.places.tolist()
    way = np.array([[0.0, 0], [3, 1], [6, 0]])
    found = Explored(places=np.array([[0.0, 0], [3, 1]]), way=way)
    figure = search_figure(found, journeys)
    squares, line, points = figure["data"]
    assert squares["x"] == [-0.45, 0.45, 0.45, -0.45, None, 2.55, 3.45, 3.45, 2.55, None]
    assert squares["y"][5:9] == [0.55, 0.55, 1.45, 1.45]
    assert (line["x"], line["y"], points["x"]) == ([0, 3, 6], [0, 1, 0], [0, 3, 6])
    assert figure["layout"]["shapes"] == map_figure(journeys)["layout"]["shapes"]
    json.dumps(figure, allow_nan=False)
    assert play_episodes(runs.train_tiny(tmp_path / "other", "point-push", generations=1), 1).explored is None


class Pole(gymnasium.Env):
    """An environment without a position."""

    observation_space = gymnasium.spaces.Box(-1, 1, (3,), np.float64)
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.uniform(-1, 1, 3), {}

    def step(self, action):
        return self.np_random.uniform(-1, 1, 3), 1.0, False, False, {}


@pytest.mark.extras
def test_an_environment_without_a_position_has_no_map(tmp_path):
    gymnasium.register("tests/Pole-v0", Pole, max_episode_steps=10)
    path = runs.train_tiny(tmp_path / "run", "gymnasium:tests/Pole-v0", algorithm="es", generations=1)
    with pytest.raises(ConfigError, match="position"):
        play_episodes(path, 2)
