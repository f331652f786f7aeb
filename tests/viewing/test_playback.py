"""Episodes of an agent, step by step: the same as evaluation's, with what is to be drawn; and `shes watch`."""

import sys
from types import SimpleNamespace

import pytest

from shes.runs.evaluate import evaluate
from shes.viewing.playback import Playback, watch


def steps_of(run, checkpoint="best", episode=0, **settings):
    playback = Playback(run, checkpoint, **settings)
    return list(playback.play(playback.seed_of(episode)))


def test_the_episode_is_the_one_that_evaluate_runs(tiny_run):
    for episode, score in enumerate(evaluate(tiny_run, episodes=3, num_workers=1).scores):
        last = steps_of(tiny_run, episode=episode)[-1]
        assert last.facts[-2:] == (f"score {score:.1f}", "time is up")
        assert last.is_last


def test_the_goal_and_a_growing_trail_are_shown(tiny_run):
    steps, objects = steps_of(tiny_run, steps=20), 16
    assert [len(step.markers) for step in steps[:3]] == [objects + 3, objects + 4, objects + 5]
    assert all(step.markers[-1].shape == "disc" for step in steps)
    assert steps[0].markers[-1].position == steps[1].markers[-1].position  # the goal is held


def test_the_goal_of_a_primitive_alone_is_its_flag(kinds):
    for step in steps_of(kinds["flag"], steps=5):
        flag, *_, goal = step.markers
        assert goal.position[:2] == pytest.approx(flag.position[:2])


def test_what_the_sensors_read_is_shown_if_asked_for(tiny_run):
    for plain, seen in zip(steps_of(tiny_run, steps=2), steps_of(tiny_run, steps=2, sensors=True), strict=True):
        assert len(seen.markers) > len(plain.markers)
        assert seen.markers[-1] == plain.markers[-1]


@pytest.mark.parametrize(
    ("checkpoint", "age"), [("0", "untrained"), ("2", "after 2 generations"), ("last", "after 4 generations")]
)
def test_the_caption_says_how_long_the_agent_was_trained(tiny_run, checkpoint, age):
    assert steps_of(tiny_run, checkpoint, steps=1)[0].facts[0] == age
    assert steps_of(tiny_run, checkpoint, steps=1, label="mine")[0].facts[:2] == ("mine", age)


def test_an_episode_that_diverges_ends_and_says_so(tiny_run):
    playback = Playback(tiny_run, "0", steps=20)
    shown = []
    for step in playback.play(3):
        shown.append(step.facts)
        if len(shown) == 3:
            playback.task.sim.qvel[0, 0] = 1e12
    assert shown[-1][-1] == "diverged"
    assert len(shown) == 4


class FakeViewer:
    """A window that is closed after 45 poses."""

    def __init__(self, spec, step_s):
        self.shown, self.is_closed = [], False
        FakeViewer.last = self

    @property
    def is_open(self):
        return len(self.shown) < 45

    def show(self, qpos, markers, *, is_new_episode, lines):
        self.shown.append((qpos, len(markers), is_new_episode, lines))

    def close(self):
        self.is_closed = True


def test_watch_shows_episodes_until_the_window_is_closed(tiny_run, monkeypatch):
    monkeypatch.setitem(sys.modules, "glfw", SimpleNamespace(init=lambda: True))
    monkeypatch.setattr("shes.drawing.window.Viewer", FakeViewer)
    watch(tiny_run)
    window = FakeViewer.last
    assert (window.is_closed, len(window.shown)) == (True, 45)
    assert [number for number, (_, _, is_new, _) in enumerate(window.shown) if is_new] == [0, 21, 42]
    for episode, start in ((0, 0), (1, 21)):
        first = steps_of(tiny_run, episode=episode, sensors=True)[0]
        pose, num_markers, _, lines = window.shown[start]
        assert (first.pose == pose).all()
        assert (num_markers, lines) == (len(first.markers), (*first.facts, *first.inputs))
    monkeypatch.setattr(FakeViewer, "show", None)  # an error closes it, too
    with pytest.raises(TypeError):
        watch(tiny_run)
    assert FakeViewer.last.is_closed
