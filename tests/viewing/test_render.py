"""Videos: their content and length, and that no partial file is left."""

import io
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from shes.drawing import opengl
from shes.errors import CheckpointError, ConfigError, RunFolderError, StorageError
from shes.runs.evaluate import evaluate
from shes.viewing.playback import Playback
from shes.viewing.render import _shown, _stacked, render
from shes.viewing.video import FRAMES_PER_SECOND, write_video
from tests.e2e import runs

HELD_FRAMES = 14


@pytest.fixture(autouse=True)
def flat(request, monkeypatch):
    """Draw without OpenGL, which is fast and works on every machine."""
    if "render" not in request.keywords:
        monkeypatch.setenv("MUJOCO_GL", "off")
    opengl.find_opengl.cache_clear()
    yield
    opengl.find_opengl.cache_clear()


def read(path):
    """Return the frames [K, H, W, 3] of a video."""
    if path.suffix == ".gif":
        with Image.open(path) as image:
            return np.array([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)])
    # Not imageio_ffmpeg.read_frames, which leaves its pipes open.
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", path, "-f", "image2pipe", "-c:v", "ppm", "-"]
    stream = io.BytesIO(subprocess.run(decode, capture_output=True, check=True).stdout)
    frames = []
    while stream.read(2) == b"P6":
        stream.readline()
        width, height = (int(word) for word in stream.readline().split())
        stream.readline()
        frames.append(np.frombuffer(stream.read(3 * width * height), np.uint8).reshape(height, width, 3))
    return np.array(frames)


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_video_has_two_frames_for_each_control_step(tiny_run, tmp_path, suffix):
    out = render(tiny_run, tmp_path / f"walk{suffix}", steps=5, size=96)
    frames = read(out)
    assert frames.shape == (2 * (5 + 1) + HELD_FRAMES, 96, 192, 3)
    assert (frames[0] != frames[11]).any()
    assert FRAMES_PER_SECOND == 20


def test_an_episode_shorter_than_a_frame_is_shown(tiny_run, tmp_path, monkeypatch):
    monkeypatch.setattr("shes.viewing.render.FRAMES_PER_SECOND", 0.01)
    assert len(read(render([tiny_run, tiny_run], tmp_path / "walk.mp4", steps=1, size=64))) == 1


@pytest.mark.parametrize(("speed", "frames"), [(0.5, 4 * 6), (2, 6), (5, 3), (100, 1)])
def test_a_faster_video_has_fewer_frames_and_ends_with_the_last_step(tiny_run, tmp_path, monkeypatch, speed, frames):
    captions = []
    monkeypatch.setattr("shes.viewing.render.captioned", lambda view, parts: captions.append(parts[0]) or view)
    out = render(tiny_run, tmp_path / "walk.mp4", steps=5, size=64, speed=speed)
    assert len(read(out)) == frames + HELD_FRAMES == len(captions) + HELD_FRAMES
    assert captions[-1][-1] == "time is up"


def test_several_checkpoints_are_side_by_side_in_the_same_episode(tiny_run, tmp_path):
    frames = read(render(tiny_run, tmp_path / "walk.mp4", checkpoints=["0", "best", "last"], steps=2, size=96))
    assert frames.shape[1:] == (192, 288, 3)
    start = frames[0][96:].astype(int)  # from above: the same food, poison and robot for all
    assert np.abs(start[:, :96] - start[:, 96:192]).mean() < 12


def test_runs_are_side_by_side_each_with_its_checkpoint_and_its_name(tiny_run, tmp_path, monkeypatch):
    flat, captions = runs.train_tiny(tmp_path / "flat", algorithm="es", generations=1), []
    monkeypatch.setattr("shes.viewing.render.captioned", lambda view, parts: captions.append(parts[0][:2]) or view)
    given = [tiny_run, tiny_run, flat]
    frames = read(render(given, tmp_path / "walk.mp4", checkpoints=["0", "last", "best"], steps=1, size=64))
    assert frames.shape[1:] == (128, 192, 3)
    assert list(dict.fromkeys(captions)) == [
        ("run", "untrained"),
        ("run", "after 4 generations"),
        ("flat", "after 1 generation"),
    ]
    captions.clear()
    render([tiny_run, flat], tmp_path / "b.mp4", labels=["two levels", "one"], steps=1, size=64)
    assert [label for label, _ in dict.fromkeys(captions)] == ["two levels", "one"]


def test_what_the_controller_sees_is_in_the_caption_if_asked_for(tiny_run, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("shes.viewing.render.captioned", lambda view, parts: seen.append(parts[1][:1]) or view)
    for sensors in (True, False):
        render(tiny_run, tmp_path / "walk.mp4", steps=1, size=64, sensors=sensors)
    assert list(dict.fromkeys(seen)) == [("controller sees 25 values",), ()]


def test_runs_whose_folders_have_the_same_name_are_called_by_their_paths(tiny_run, run_copy, tmp_path):
    other = run_copy.rename(tmp_path / tiny_run.name)
    shown = _shown([tiny_run, other], ["best"], [])
    assert shown == [(run, "best", str(run)) for run in (tiny_run, other)]
    assert [label for *_, label in _shown([tiny_run], ["0", "best"], [])] == ["", ""]


@pytest.mark.parametrize(
    ("count", "arguments", "message"),
    [
        (0, {}, r"render needs at least one run: shes render RUN"),
        (3, {"checkpoints": ["0", "best"]}, r"3 runs need one checkpoint for all or one for each, got 2: 0, best\."),
        (2, {"checkpoints": ["0", "best", "last"]}, r"2 runs need one checkpoint .* got 3"),
        (2, {"labels": ["A"]}, r"one label for each of the 2 agents in the video, got 1: A\. Set --labels"),
        (1, {"labels": "A", "checkpoints": ["0", "best"]}, r"one label for each of the 2 agents"),
    ],
)
def test_numbers_of_runs_and_checkpoints_that_do_not_fit_are_refused(tiny_run, tmp_path, count, arguments, message):
    with pytest.raises(ConfigError, match=message):
        render([tiny_run] * count, tmp_path / "walk.mp4", **arguments)
    assert list(tmp_path.iterdir()) == []


def test_views_are_stacked_to_one_height():
    view = np.full((4, 6, 3), 9, np.uint8)
    assert _stacked([view, view], 2).shape == _stacked([view], 2).shape == (8, 6, 3)
    assert _stacked([view], 2)[4:].max() == 0


def test_what_the_sensors_read_is_shown_if_asked_for(tiny_run):
    plain, seen = (Playback(tiny_run, "best", steps=2, sensors=sensors) for sensors in (False, True))
    for without, with_them in zip(plain.play(3), seen.play(3), strict=True):
        lines = len(with_them.markers) - len(without.markers)
        assert lines > 0
        assert with_them.markers[-1] == without.markers[-1]


@pytest.mark.parametrize("camera", ["follow", "top"])
def test_one_camera_is_one_view(tiny_run, tmp_path, camera):
    assert read(render(tiny_run, tmp_path / "walk.mp4", camera=camera, steps=1, size=64)).shape[1:] == (64, 64, 3)


def test_a_video_shows_the_episode_that_evaluate_runs(tiny_run):
    scores = evaluate(tiny_run, episodes=3, num_workers=1).scores
    for episode, score in enumerate(scores):
        playback = Playback(tiny_run, "best")
        *_, last = playback.play(playback.seed_of(episode))
        assert last.facts[-2:] == (f"score {score:.1f}", "time is up")


def test_the_same_arguments_give_the_same_video(tiny_run, tmp_path):
    first = render(tiny_run, tmp_path / "a.mp4", steps=2, size=64).read_bytes()
    assert render(tiny_run, tmp_path / "b.mp4", steps=2, size=64).read_bytes() == first
    assert render(tiny_run, tmp_path / "c.mp4", steps=2, size=64, episode=1).read_bytes() != first
    assert render(tiny_run, tmp_path / "d.mp4", steps=2, size=64, seed=8).read_bytes() != first


def test_a_listener_hears_of_every_control_step(tiny_run, tmp_path):
    heard = []
    render(tiny_run, tmp_path / "a.gif", steps=3, size=64, on_step=lambda *step: heard.append(step))
    assert heard == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_the_goal_and_the_trail_are_shown(tiny_run):
    playback = Playback(tiny_run, "best", steps=20)
    moments = list(playback.play(playback.seed_of(0)))
    objects = 16
    assert [len(moment.markers) for moment in moments[:3]] == [objects + 3, objects + 4, objects + 5]
    for moment in moments:
        *_, goal = moment.markers
        assert goal.shape == "disc"
    assert moments[0].markers[-1].position == moments[1].markers[-1].position  # held


def test_of_a_flat_agent_there_is_a_trail_but_no_goal(tmp_path):
    """The disc under the robot is the last marker: there is no goal and no line to one."""
    playback = Playback(runs.train_tiny(tmp_path / "run", algorithm="es", generations=1), "best", steps=5)
    moments = list(playback.play(playback.seed_of(0)))
    assert [len(moment.markers) for moment in moments] == [16 + 1 + trail for trail in range(6)]
    for moment in moments:
        assert moment.markers[-1].position[:2] == pytest.approx(moment.pose[:2])
    assert playback._agent.goal is None


def test_of_a_primitive_alone_the_goal_is_where_its_flag_is(tmp_path):
    playback = Playback(runs.train_tiny(tmp_path / "run", "point-flagrun", generations=1), "best", steps=5)
    for moment in playback.play(playback.seed_of(0)):
        flag, *_, goal = moment.markers
        assert goal.position[:2] == pytest.approx(flag.position[:2])


@pytest.mark.parametrize(
    ("checkpoint", "age"), [("0", "untrained"), ("2", "after 2 generations"), ("last", "after 4 generations")]
)
def test_the_caption_says_how_long_the_agent_was_trained(tiny_run, checkpoint, age):
    playback = Playback(tiny_run, checkpoint, steps=1)
    assert next(playback.play(0)).facts[0] == age


def test_the_caption_says_how_the_episode_ended(tiny_run, monkeypatch):
    playback = Playback(tiny_run, "0", steps=20)
    task = playback.task
    shown = []
    for moment in playback.play(3):
        shown.append(moment.facts)
        if len(shown) == 3:
            task.sim.qvel[0, 0] = 1e12
    assert shown[-1][-1] == "diverged"
    assert len(shown) == 4


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"out": "walk.avi"}, ConfigError, "must end in .mp4 or .gif, got 'walk.avi'. Set --out"),
        ({"out": "nowhere/walk.mp4"}, ConfigError, "no folder nowhere"),
        ({"checkpoints": ()}, ConfigError, "at least one checkpoint"),
        ({"checkpoints": ("77",)}, CheckpointError, "there is no checkpoint .* There are: .*best"),
        ({"size": 65}, ConfigError, "size must be an even number of pixels, got 65. Set --size"),
    ],
)
def test_a_wrong_argument_is_refused_before_any_work(tiny_run, tmp_path, monkeypatch, arguments, error, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        render(tiny_run, **{"out": "walk.mp4", **arguments})
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match="not a run folder"):
        render(tmp_path, tmp_path / "walk.mp4")


def test_a_folder_is_not_written_over(tiny_run, tmp_path):
    (tmp_path / "walk.mp4").mkdir()
    with pytest.raises(ConfigError, match="is a folder"):
        render(tiny_run, tmp_path / "walk.mp4")


def test_a_video_that_fails_leaves_what_was_there(tmp_path):
    out = tmp_path / "walk.mp4"
    out.write_bytes(b"the last one")

    def frames():
        yield np.zeros((64, 64, 3), np.uint8)
        raise StorageError("no more")

    with pytest.raises(StorageError, match="no more"):
        write_video(out, frames())
    assert out.read_bytes() == b"the last one"
    assert [path.name for path in tmp_path.iterdir()] == ["walk.mp4"]


def test_an_encoder_that_fails_is_an_error_of_storage(tmp_path, monkeypatch):
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: "/bin/false")
    out = tmp_path / "walk.mp4"
    out.write_bytes(b"the last one")
    with pytest.raises(StorageError, match=r"could not encode .*untouched\. It said: .*temporary folder .* TMPDIR"):
        write_video(out, iter([np.zeros((64, 64, 3), np.uint8)] * 3))
    assert out.read_bytes() == b"the last one"
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_file_that_the_encoder_did_not_finish_takes_no_place(tmp_path, monkeypatch, suffix):
    """As on a full disk: ffmpeg writes part of the file, then fails."""
    ffmpeg = tmp_path / "ffmpeg"
    ffmpeg.write_text('#!/bin/sh\nfor last; do :; done\necho part > "$last"\ncat > /dev/null\necho full >&2\nexit 1\n')
    ffmpeg.chmod(0o755)
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(ffmpeg))
    out = tmp_path / f"walk{suffix}"
    out.write_bytes(b"the last one")
    with pytest.raises(StorageError, match=r"It said: full\."):
        write_video(out, iter([np.zeros((64, 64, 3), np.uint8)] * 3))
    assert out.read_bytes() == b"the last one"


def test_a_missing_encoder_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: "/nowhere/ffmpeg")
    with pytest.raises(ConfigError, match=r"no ffmpeg: /nowhere/ffmpeg is not there.*IMAGEIO_FFMPEG_EXE"):
        write_video(tmp_path / "walk.mp4", iter([]))


@pytest.mark.render
def test_a_video_by_opengl(tiny_run, tmp_path):
    if opengl.find_opengl() is None:
        pytest.skip("there is no OpenGL here (EGL or OSMesa)")
    frames = read(render(tiny_run, tmp_path / "walk.mp4", steps=4, size=128))
    assert frames.shape == (2 * 5 + HELD_FRAMES, 128, 256, 3)
    assert frames[0].std() > 10
    assert (frames[0] != frames[9]).any()
