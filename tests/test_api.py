"""`import shes`: light, and the whole way from training to acting."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest

import shes
from tests.e2e import runs


def loaded_by(*statements):
    """Return the packages that a new interpreter has loaded after each of the `statements`, one after another."""
    code = "import sys\n" + "".join(f"{each}\nprint('loaded', *sys.modules)\n" for each in statements)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = (line.split() for line in done.stdout.splitlines() if line.startswith("loaded "))
    return [{name.partition(".")[0] for name in line} for line in lines]


def test_nothing_slow_is_imported_before_it_is_needed():
    overview = "from shes.cli import main; main(['--help'])"
    alone, worker, *face = loaded_by(overview, "import shes.rollout.worker", "shes.load", "shes.train")
    no_face = {"PIL", "imageio_ffmpeg", "matplotlib", "tensorboardX", "tyro"}
    heavy = {*no_face, "gymnasium", "mujoco", "numpy", "rich", "scipy"}
    assert alone & heavy == set()
    assert worker & heavy <= {"gymnasium", "mujoco", "numpy"}
    for found in face:
        assert found & no_face == set()


def test_a_reloaded_package_registers_its_environments():
    reloaded = "import shes, importlib; importlib.reload(shes)"
    (found,) = loaded_by(f"{reloaded}; import gymnasium, mujoco; gymnasium.spec('shes/AntGather-v0')")
    assert found >= {"gymnasium", "mujoco", "shes"}


def test_events_are_written_without_an_installed_pytorch(tmp_path):
    (tmp_path / "torch.py").touch()
    opened = f"import pathlib; sys.path.append({str(tmp_path)!r}); from shes.runs.tables import Events"
    (found,) = loaded_by(f"{opened}; Events(pathlib.Path({str(tmp_path / 'events')!r}), 0, {{}})")
    assert found & {"tensorboardX", "torch"} == {"tensorboardX"}


def test_the_face_has_what_it_says():
    for name in shes.__all__:
        assert getattr(shes, name) is not None
    assert set(shes.__all__) <= set(dir(shes))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("api") / "run"
    return shes.train("point-gather", out=path, **{**runs.TINY, "generations": 2})


def test_train_resume_evaluate_and_load_go_together(tiny_run, tmp_path):
    hidden = [4]
    settings = {**runs.TINY, "seed": np.int64(5), "generations": np.int32(2), "hidden": hidden}
    half = shes.train("point-gather", out=tmp_path / "half", **settings)
    assert hidden == [4]
    resumed = shes.resume(str(half.path), generations=4)
    assert resumed.generation == 4
    assert runs.differences(tiny_run, resumed.path) == []
    one, other = (shes.evaluate(path, episodes=3, num_workers=1) for path in (tiny_run, str(resumed.path)))
    assert one.summary() == other.summary()
    assert shes.plot(resumed, tmp_path / "curves.png").is_file()  # a run stands for its folder


class Listener:
    """Keeps what it hears."""

    def __init__(self):
        self.heard = []

    def on_start(self, path, config, generation, num_workers):
        self.heard.append(("start", path, generation, num_workers))

    def on_generation(self, row):
        self.heard.append(("generation", row["generation"], row["env_steps"]))

    def on_evaluation(self, row):
        self.heard.append(("evaluation", row["generation"], row["episodes"]))

    def on_event(self, event):
        self.heard.append(("event", event))


def test_listeners_hear_of_everything_in_order(tmp_path):
    """They have all methods, or some, or are functions of a row."""
    listener, rows, scores = Listener(), [], []
    some = type("Some", (), {"on_evaluation": lambda _, row: scores.append(row["score_mean"])})()
    run = shes.train("point-gather", out=tmp_path / "run", listener=[listener, rows.append, some], **runs.TINY)
    assert listener.heard == [
        ("start", run.path, 0, 1),
        ("generation", 1, 160),
        ("evaluation", 1, 3),
        ("generation", 2, 320),
        ("evaluation", 2, 3),
        ("generation", 3, 480),
        ("generation", 4, 640),
        ("evaluation", 4, 3),
    ]
    assert [row["generation"] for row in rows] == [1, 2, 3, 4]
    assert scores == run.evaluations["score_mean"].tolist()


def stops(row):
    raise shes.StopTraining


@pytest.mark.parametrize(
    "listener",
    [
        lambda row: row["generation"] == 2,
        lambda row: np.float64(row["generation"]) > 1,  # a bool of NumPy
        lambda row: stops(row) if row["generation"] == 2 else 1,  # 1 is not True
        type("After", (), {"on_evaluation": lambda _, row: row["generation"] == 2})(),
    ],
)
def test_a_listener_ends_the_run_well(tmp_path, run, listener):
    stopped = shes.train("point-gather", out=tmp_path / "run", listener=listener, **runs.TINY)
    assert stopped.generation == 2
    assert runs.differences(run.path, stopped.path) == []
    assert "a listener ends the run" in runs.log_lines(stopped.path)
    assert shes.resume(stopped, generations=3).generation == 3


def test_progress_is_shown_in_a_terminal_or_on_request(tmp_path, capsys, monkeypatch):
    heard = []
    settings = {**runs.TINY, "generations": 1}
    shes.train("point-gather", out=tmp_path / "silent", **settings)
    assert capsys.readouterr().out == ""
    shes.train("point-gather", out=tmp_path / "shown", listener=heard.append, progress=True, **settings)
    assert "generation 1 / 1" in capsys.readouterr().out
    monkeypatch.setattr("rich.console.Console.is_terminal", True)
    shes.train("point-gather", out=tmp_path / "terminal", listener=heard.append, **settings)
    assert "generation" in capsys.readouterr().out
    shes.resume(tmp_path / "terminal", generations=2, listener=heard.append, progress=False)
    assert capsys.readouterr().out == ""
    shes.resume(tmp_path / "shown", generations=2, progress=True)
    assert "after generation 1. Run folder" in capsys.readouterr().out
    assert len(heard) == 3


class Failing(Listener):
    def on_generation(self, row):
        raise ZeroDivisionError("a listener's own fault")


def test_a_thread_leaves_no_process_and_a_run_that_goes_on(tmp_path, run):
    path, before, others = tmp_path / "run", threading.active_count(), psutil.Process().children()
    settings = {"generations": 2, "backend": "processes", "num_workers": 1, "listener": Failing()}
    with ThreadPoolExecutor(1) as pool:
        failed = pool.submit(runs.train_tiny, path, **settings).exception()
    assert isinstance(failed, ZeroDivisionError)
    assert psutil.Process().children() == others
    assert threading.active_count() == before
    shes.resume(path, backend="serial")
    assert runs.differences(run.path, path) == []


def test_only_what_draws_reads_mujoco_gl(tmp_path):
    (tmp_path / "mine.py").write_text("import mujoco")
    code = """
import gymnasium, os, shes.cli
assert shes.cli.main(["demo", "--import", "mine"]) == 2
run = shes.train("point-flagrun", preset="smoke", generations=1, num_workers=2)
print(os.listdir("runs") == [run.path.name], gymnasium.make("shes/PointGather-v0").observation_space.shape)
shes.render(run.path, "walk.mp4")"""
    how = {"cwd": tmp_path, "env": {**os.environ, "MUJOCO_GL": "nonsense"}, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", code], **how, check=False)
    assert done.stdout.splitlines()[-1:] == ["True (25,)"], done.stderr
    assert done.stderr.count("MUJOCO_GL asks for nonsense, which does not work here. Unset") == 2
