"""Training: which evaluation is the best one, what is kept of it, and what is written in which order."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import shes
from shes.errors import ConfigError
from shes.runs.evaluate import Evaluation
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from tests.e2e import runs


@pytest.mark.parametrize(
    ("found", "best"),
    [  # scores and returns
        ([(3, 0), (2, 9), (1, 9)], 1),
        ([(1, 0), (2, 0), (3, 0)], 4),
        ([(3, 5), (3, 4), (0, 0)], 1),  # a tie goes to the higher return
        ([(3, 5), (3, 5), (0, 0)], 2),  # then to the later one
        ([(-3, 0), (-2, 0), (-9, 0)], 2),
    ],
)
def test_the_best_evaluation_is_kept_also_over_a_resume(tmp_path, monkeypatch, found, best):
    names, left = ("primitive_returns", "goals_reached", "successes", "steps", "diverged"), iter(found)

    def evaluate(*_):  # after generations 1, 2 and 4
        scores, returns = (np.full(2, value) for value in next(left))
        return Evaluation(scores=scores, returns=returns, **dict.fromkeys(names, np.zeros(2)))

    monkeypatch.setattr("shes.runs.recorder.evaluate_state", evaluate)
    path = runs.train_tiny(tmp_path / "run", generations=2)
    run = shes.resume(path, generations=4)
    assert run.best.generation == best
    folder = RunFolder.open(path)
    kept = folder.load("best")
    assert kept.generation == kept.best.generation == best
    if best != 1:  # every second generation is kept
        one, other = (runs.state(path, name).levels[0].theta for name in ("best", best))
        assert one.tobytes() == other.tobytes()


def test_a_run_that_is_not_over_says_how_it_goes_on(tmp_path):
    path = tmp_path / "run"
    stopped = shes.train("point-gather", out=path, minutes=1e-9, **runs.TINY)
    go_on = ["Stopped: 0 of 4 generations, no evaluation yet.", f"Go on: shes resume {path}"]
    assert stopped.listing().parts[:2] == go_on
    assert RunFolder(path).load("best").generation == 0  # before the first evaluation, the best is the start
    assert RunFolder(path).load("last").best.generation == -1


def test_a_generation_is_written_as_rows_then_checkpoints(tmp_path, monkeypatch):
    """A machine that goes down loses what is not: a checkpoint whose rows are missing could not go on."""
    path, synced, original = runs.train_tiny(tmp_path / "run", generations=1), [], os.fsync

    def sync(number):
        name = Path(f"/proc/self/fd/{number}").readlink().name.lstrip(".").partition(".")[0]
        synced.append(name)
        original(number)

    monkeypatch.setattr(os, "fsync", sync)
    shes.resume(path, generations=2)
    names = ("progress", "evaluation", "generation_000002", "last")
    ours = [name for name in synced if name in names]
    assert ours[2:] == list(names)  # the two tables are cut when the run goes on


def test_a_run_ends_with_the_generation_that_reaches_its_steps(tmp_path, tiny_run):
    path = runs.train_tiny(tmp_path / "run", env_steps=161)  # a generation has 160
    assert (runs.state(path).generation, runs.state(path).env_steps) == (2, 320)
    with pytest.raises(ConfigError, match=r"made 320 environment steps, but --env-steps is 161.*--env-steps 640"):
        shes.resume(path)
    assert shes.resume(path, env_steps=10_000).generation == 4
    assert runs.differences(tiny_run, path) == []


def test_a_row_has_steps_and_time_and_a_run_gives_warnings(tmp_path):
    settings = {"primitive_view": "egocentric", "primitive_estimate": "interval", "controller_interval": 4}
    settings |= {"practice": 3, "sigma_end": 0.05, "schedule_generations": 3}
    idle = "the controller does not learn: practice takes 3 generations: see --practice"
    late = "schedules end after 6 generations, but the run after {}: see --schedule-generations"
    heard, told = [], "a branch has 12 steps, more than an episode (8): see --intervals"
    listener = SimpleNamespace(on_event=heard.append)
    path = runs.train_tiny(tmp_path / "run", **settings, horizon=8, intervals=3, generations=3, listener=listener)
    shes.resume(path, generations=4, listener=listener)
    assert heard == [told, idle, late.format(3), told, late.format(4)]
    assert told in runs.log_lines(path)
    table = read_csv(path / "progress.csv")
    assert table["generation"].tolist() == [1, 2, 3, 4]
    assert table["env_steps"][-1] == runs.state(path).env_steps
    seconds = np.diff(table["env_steps"], prepend=0) / table["env_steps_per_s"]
    assert (seconds >= 0.999 * (table["rollout_s"] + table["update_s"]) - 1e-3).all()
    assert (np.diff(table["wall_time_s"]) >= seconds[1:] + table["evaluation_s"][:-1] - 0.01)[:2].all()
