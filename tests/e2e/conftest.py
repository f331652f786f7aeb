"""Runs that end-to-end tests share."""

import os
import signal

import pytest

from tests.e2e import runs

KILLED = {"population_size": 32, "hidden": (8,), "horizon": 200, "evaluation_horizon": 100}
"""Settings of the runs that are killed: a generation takes long enough to be hit."""


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory):
    """Folder of such a run that nothing happened to. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("undisturbed") / "run", **KILLED)


@pytest.fixture
def started(tmp_path):
    """Return a function that starts such a run and returns its process and folder; nothing is left after the test."""
    processes = []

    def begin(num_workers=2):
        path = tmp_path / f"run{len(processes)}"
        settings = {**runs.TINY, **KILLED, "backend": "processes", "num_workers": num_workers, "out": path}
        process = runs.start("train", "point-gather", *runs.flags(**settings))
        processes.append(process)
        return process, path

    yield begin
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
