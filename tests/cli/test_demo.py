"""The demo, with a tiny run instead of minutes of training."""

from functools import partial
from pathlib import Path

import pytest

import shes
from shes.cli import demo, main
from shes.runs.folder import RunFolder
from tests.e2e import runs

TINY = demo.Stage("tiny", "point-gather", "scores", {"camera": "top", "steps": 2}, {**runs.TINY, "seed": 3})


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """A working directory of its own, and pictures without OpenGL, which are fast and work on every machine."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "off")


def test_runs_are_trained_compared_and_drawn(capsys, monkeypatch):
    drawn, render = [], shes.render
    monkeypatch.setattr(shes, "render", lambda *_, **given: drawn.append(given) or render(*_, **given))
    monkeypatch.setitem(vars(shes), "plot", lambda _, path: path)  # before it imports Matplotlib
    monkeypatch.setattr(shes, "evaluate", partial(shes.evaluate, num_workers=1))
    walking = TINY._replace(name="walking", env="point-flagrun", column="returns")
    monkeypatch.setattr(demo, "STAGES", (walking, TINY))
    monkeypatch.setattr(demo, "EPISODES", 5)
    assert main(["demo"]) == 0
    out = capsys.readouterr().out
    (folder,) = Path("runs").iterdir()
    for stage, given in zip((walking, TINY), drawn, strict=True):
        run = folder / stage.name
        evaluate = partial(shes.evaluate, run, episodes=5, seed=0)
        before, after = (getattr(evaluate(checkpoint=name), stage.column) for name in given["checkpoints"])
        means = f"{before.mean():.2f} before training, {after.mean():.2f} after"
        if stage is TINY:
            others = (evaluate(controller=name) for name in ("constant", "random"))
            means += "; with constant goals {:.2f}, with random ones {:.2f}".format(*(e.scores.mean() for e in others))
        assert f"Mean {stage.column[:-1]} of 5 fresh episodes: {means}.\n" in out
        assert (given["episode"], given["seed"]) == (abs(after - after.mean()).argmin(), 0)  # the typical one
        assert f"{stage.name}: {run.with_suffix('.mp4')}   curves: {run / 'curves.png'}" in out
        assert run.with_suffix(".mp4").stat().st_size > 0
    assert RunFolder.open(folder / "tiny").read_config().transfer.primitive.endswith("walking")
    assert f"resume {folder / 'tiny'} --generations 200" in out


def test_ctrl_c_names_the_folder_of_the_runs(monkeypatch, capsys):
    def interrupted(env, out, **_):
        out.mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr(shes, "train", interrupted)
    assert main(["demo"]) == 130
    assert "\nStopped; the runs so far are in runs/demo-" in capsys.readouterr().out
