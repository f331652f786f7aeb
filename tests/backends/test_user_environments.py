"""A user's environment in workers: a few instances, each closed in the end, and errors that name the line at fault."""

import os
import signal
import sys
import traceback

import gymnasium
import pytest

import shes
from shes.errors import ConfigError
from shes.machine import signals_delayed
from tests.e2e import runs

MODULE = """
import os
import time
from pathlib import Path
import gymnasium
import numpy as np
class Env(gymnasium.Env):
    action_space = observation_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    diary = Path(__file__).with_name("diary")
    def note(self, what):
        with self.diary.open("a") as file:
            file.write(f"{what} {os.getpid()} {id(self)}\\n")
    def __init__(self, render_mode=None, fault=""):
        self.fault, self.memory = fault, np.ones(5 * 10**7 if fault == "heavy" else 1)
        self.note("made")
        time.sleep(0.1 if fault == "slow" else 0)
    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.zeros(1, np.float32), {}
    def step(self, action):
        if self.fault == "key":
            {}["missing"]  # the line at fault
        self.steps += 1
        return np.zeros(1, np.float32), float(action[0]), self.steps >= 5, False, {}
    def close(self):
        self.note("closed")
        if self.fault == "close":
            raise OSError("the window is gone")
for fault in ("", "key", "close", "heavy", "slow"):
    gymnasium.register(f"User{fault.title()}-v0", Env, max_episode_steps=5, kwargs={"fault": fault})
"""
SETTINGS = {"algorithm": "es", "preset": "smoke", "generations": 1, "hidden": (4,)}


@pytest.fixture
def diary(tmp_path, monkeypatch):
    """Return a function that returns what environments have noted: a set of (process, object) by event."""
    (tmp_path / "users_module.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "users_module", raising=False)
    for name in [name for name in gymnasium.registry if name.startswith("User")]:
        del gymnasium.registry[name]
    __import__("users_module")

    def read():
        lines = [line.split() for line in (tmp_path / "diary").read_text().splitlines()]
        return [[tuple(rest) for kind, *rest in lines if kind == each] for each in ("made", "closed")]

    return read


def test_every_environment_is_closed_and_there_are_few(diary, tmp_path):
    shes.train("gymnasium:UserClose-v0", out=tmp_path / "run", **SETTINGS, backend="serial", population_size=200)
    made, closed = diary()
    assert len(closed) == len(made) <= 48  # though each raises; those of training, evaluation and inspection


def test_an_error_names_the_line_of_the_users_code(diary, tmp_path):
    with pytest.raises(ConfigError) as raised:
        shes.train("gymnasium:UserKey-v0", out=tmp_path / "run", **SETTINGS, backend="processes", num_workers=1)
    line = 1 + next(i for i, text in enumerate(MODULE.splitlines()) if text.endswith("# the line at fault"))
    file = tmp_path / "users_module.py"
    assert str(raised.value) == f"gymnasium:UserKey-v0 cannot step: KeyError: 'missing' ({file}:{line})"
    told = "".join(traceback.format_exception(raised.value))
    for text in (told, (tmp_path / "run" / "log.txt").read_text()):
        assert f'File "{file}", line {line}, in step' in text
    made, closed = diary()
    assert len(closed) == len(made)


def test_the_memory_of_environments_counts(diary, tmp_path, monkeypatch):
    monkeypatch.setattr("shes.runs.build.free_memory", lambda: 3 * 10**8)
    shes.train("gymnasium:User-v0", out=tmp_path / "light", **SETTINGS, backend="serial")
    with pytest.raises(ConfigError, match=r"GB of memory, but 0.3 GB are free"):
        shes.train("gymnasium:UserHeavy-v0", out=tmp_path / "heavy", **SETTINGS, backend="serial")


@pytest.mark.extras
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_run_closes_environments(diary, tmp_path, monkeypatch, number):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    words = runs.flags(**{**SETTINGS, "generations": 10_000, "workers": 2, "out": tmp_path / "run"})
    process = runs.start("train", "gymnasium:UserSlow-v0", "--import", "users_module", *words)
    runs.wait_until(lambda: (tmp_path / "diary").exists() and len(diary()[0]) > 6, "workers make environments")
    process.send_signal(number) if number == signal.SIGTERM else os.killpg(process.pid, number)
    assert runs.finish(process)[0] == 130
    made, closed = diary()
    assert len(closed) == len(made)


def test_a_signal_waits_for_the_end_of_the_block_but_not_in_a_forked_process():
    told = []
    before = signal.signal(signal.SIGTERM, lambda *_: told.append(1))
    with signals_delayed():
        if not (child := os.fork()):
            signal.raise_signal(signal.SIGTERM)
            os._exit(len(told))
        signal.raise_signal(signal.SIGTERM)
        assert (os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), len(told)) == (1, 0)
    with signals_delayed():
        signal.raise_signal(signal.SIGTERM)
        assert len(told) == 1  # of the first block
        signal.raise_signal(signal.SIGTERM)
        assert len(told) == 3  # a second one does not wait
    signal.signal(signal.SIGTERM, before)
