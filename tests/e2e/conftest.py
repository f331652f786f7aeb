"""Runs that end-to-end tests share."""

import os
import signal
from functools import cache

import pytest

from tests.e2e import runs

KILLED = {
    "preset": "smoke",
    "seed": 3,
    "num_workers": 2,
    "population_size": 32,
    "hidden": (8,),
    "horizon": 200,
    "evaluation_horizon": 100,
    "generations": 4,
    "evaluation_interval": 2,
    "evaluation_episodes": 4,
    "keep_checkpoints": 2,
    "noise_table_size": 1_000_000,
}
"""Settings of the runs that are killed: a generation takes long enough to be hit."""

BRANCHED = {
    "population_size": 4,
    "horizon": 25,
    "primitive_view": "egocentric",
    "primitive_estimate": "interval",
    "primitive_population_size": 300,
}
"""What makes nearly all of a generation branches beside a controller: whole episodes are few and short."""


@pytest.fixture(scope="session")
def undisturbed_with(tmp_path_factory):
    """Return a function that returns the folder of a run of `started` that nothing happened to. Not to be changed."""

    @cache
    def run(**settings):
        path = tmp_path_factory.mktemp("undisturbed") / "run"
        return runs.train_tiny(path, **{**KILLED, "backend": "serial", **settings})

    return run


@pytest.fixture(scope="session")
def undisturbed(undisturbed_with):
    """Folder of such a run with no more settings."""
    return undisturbed_with()


@pytest.fixture
def started(tmp_path):
    """Return a function that starts such a run with more settings and returns its process and folder.

    Whatever happens, nothing of it is left after the test.
    """
    processes = []

    def begin(**settings):
        path = tmp_path / f"run{len(processes)}"
        process = runs.start("train", "point-gather", *runs.flags(**{**KILLED, **settings}, out=path))
        processes.append(process)
        return process, path

    yield begin
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
