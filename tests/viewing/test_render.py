"""Videos: their frames, size and episode, and the errors of an encoder."""

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from shes.errors import ConfigError, StorageError
from shes.viewing.render import render, write_video
from tests.messages import raises

HELD_FRAMES = 14


def read(path):
    """Return the frames [K, H, W, 3] of a .gif."""
    with Image.open(path) as image:
        return np.array([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)])


def test_a_video_has_two_frames_for_each_control_step(tiny_run, tmp_path):
    heard = []
    frames = read(render(tiny_run, tmp_path / "walk.gif", steps=5, size=96, on_step=lambda *step: heard.append(step)))
    assert frames.shape == (2 * (5 + 1) + HELD_FRAMES, 96, 192, 3)
    assert (frames[0] != frames[11]).any()
    assert (frames[4] != frames[5]).any()  # poses between steps are interpolated
    assert heard == [(step, 5) for step in range(6)]
    film = render(tiny_run, tmp_path / "walk.mp4", steps=5, size=96)
    assert imageio_ffmpeg.count_frames_and_secs(film)[0] == len(frames)


@pytest.mark.parametrize(("speed", "frames"), [(0.5, 4 * 6), (5, 3), (100, 1)])
def test_a_faster_video_has_fewer_frames(tiny_run, tmp_path, speed, frames):
    """One frame of a step is left, however fast, and the last shows the end."""
    shown = read(render(tiny_run, tmp_path / "walk.gif", steps=5, size=64, speed=speed))
    assert len(shown) == frames + HELD_FRAMES
    first, *_, last = read(render(tiny_run, tmp_path / "slow.gif", steps=5, size=64))
    assert np.abs(shown[-1].astype(int) - last).mean() < np.abs(shown[-1].astype(int) - first).mean() / 1.5


def test_checkpoints_are_side_by_side_in_the_same_episode(tiny_run, tmp_path):
    frames = read(render(tiny_run, tmp_path / "walk.gif", checkpoints=["0", "best", "last"], steps=2, size=96))
    assert frames.shape[1:] == (192, 288, 3)
    start = frames[0][96:].astype(int)  # from above: the same food, poison and robot for all
    assert np.abs(start[:, :96] - start[:, 96:192]).mean() < 12


def test_runs_are_side_by_side_each_with_its_name(kinds, run_copy, tmp_path, monkeypatch):
    captions = []
    monkeypatch.setattr("shes.viewing.render.captioned", lambda view, parts: captions.append(parts[0][:2]) or view)
    flat, first = kinds["flat"], kinds["first"]
    given = [first, first, flat]
    frames = read(render(given, tmp_path / "walk.gif", checkpoints=["0", "last", "best"], steps=1, size=64))
    assert frames.shape[1:] == (128, 192, 3)
    ages = ("untrained", "after 4 generations", "after 2 generations")
    assert list(dict.fromkeys(captions))[:2] == list(zip(("first", "first"), ages[:2], strict=True))
    assert captions[2][0] == "flat"
    captions.clear()
    other = run_copy.rename(tmp_path / "first")  # of the same name
    render([first, other], tmp_path / "walk.mp4", steps=1, size=64)
    assert {label for label, _ in captions} == {str(first), str(other)}


def test_the_same_arguments_give_the_same_video(tiny_run, tmp_path):
    def made(**settings):
        return render(tiny_run, tmp_path / "a.mp4", steps=2, size=64, **settings).read_bytes()

    first = made()
    assert made() == first
    for different in ({"episode": 1}, {"seed": 8}, {"sensors": True}):
        assert made(**different) != first


def black(count=3):
    return iter([np.zeros((64, 64, 3), np.uint8)] * count)


def broken():
    yield from black(1)
    raise StorageError("no more")


PARTIAL = 'for last; do :; done\necho part > "$last"\ncat > /dev/null\necho full >&2\nexit 1'
"""An encoder on a full disk: it writes part of the file, then fails."""


@pytest.mark.parametrize(
    ("suffix", "encoder", "frames", "error", "message"),
    [
        (".mp4", None, broken, StorageError, "no more"),
        (".gif", None, broken, StorageError, "no more"),
        (".mp4", "exit 1", black, StorageError, "could not encode ... untouched. It said: ... TMPDIR"),
        (".gif", PARTIAL, black, StorageError, "It said: full."),
        (".gif", "gone", black, ConfigError, "no ffmpeg: ... encoder is not there ... IMAGEIO_FFMPEG_EXE"),
    ],
)
def test_a_video_that_fails_leaves_what_was_there(tmp_path, monkeypatch, suffix, encoder, frames, error, message):
    path, out = tmp_path / "encoder", tmp_path / f"walk{suffix}"
    if encoder:
        monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(path))
    if encoder and encoder != "gone":
        path.write_text(f"#!/bin/sh\n{encoder}\n")
        path.chmod(0o755)
    out.write_bytes(b"the last one")
    with raises(error, message):
        write_video(out, frames())
    assert out.read_bytes() == b"the last one"
    assert {each.name for each in tmp_path.iterdir()} <= {out.name, "encoder"}
