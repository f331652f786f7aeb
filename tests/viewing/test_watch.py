"""`watch` shows one episode after another until the window is closed."""

import pytest

from shes.errors import ConfigError
from shes.viewing.playback import Playback
from shes.viewing.watch import watch


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


def test_episodes_follow_each_other_until_the_window_is_closed(tiny_run, monkeypatch):
    monkeypatch.setattr("shes.drawing.rendering.Viewer", FakeViewer)
    watch(tiny_run)
    window = FakeViewer.last
    assert window.is_closed
    assert len(window.shown) == 45
    assert [number for number, (_, _, is_new, _) in enumerate(window.shown) if is_new] == [0, 21, 42]
    playback = Playback(tiny_run, "best", sensors=True)
    for episode, start in ((0, 0), (1, 21)):
        first = next(iter(playback.play(playback.seed_of(episode))))
        assert (first.pose == window.shown[start][0]).all()
        assert len(first.markers) == window.shown[start][1]  # with what the sensors read
        assert "controller sees 25 values" in first.seen
        assert window.shown[start][3] == (*first.facts, *first.seen)


def test_the_window_is_closed_after_an_error(tiny_run, monkeypatch):
    class Broken(FakeViewer):
        def show(self, qpos, markers, *, is_new_episode, lines):
            raise ConfigError("lost the screen")

    monkeypatch.setattr("shes.drawing.rendering.Viewer", Broken)
    with pytest.raises(ConfigError, match="lost the screen"):
        watch(tiny_run)
    assert FakeViewer.last.is_closed
