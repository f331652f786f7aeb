"""What every test shares: one BLAS thread, no display, no touch of the user's cache."""

import gc
import os
import shutil
import signal

# Before NumPy is imported: BLAS reads them once, and its thread count changes bits. Worker processes inherit them.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MPLBACKEND"] = "Agg"

import hypothesis
import pytest

# Processes that tests interrupt would inherit what a job in a shell's background (Ctrl-C) and nohup (SIGHUP) ignore.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, signal.default_int_handler)

# No deadline: a busy machine is no failure. In CI the examples are the same each time. The fast tests have three
# minutes: `make test-extras` and `make test-all` look at more examples.
hypothesis.settings.register_profile("shes", deadline=None, derandomize="CI" in os.environ, max_examples=25)
hypothesis.settings.register_profile("thorough", hypothesis.settings.get_profile("shes"), max_examples=100)
hypothesis.settings.load_profile("shes")


gc.disable()  # until the tests are collected


def pytest_collection_finish(session):
    """Keep the garbage collector from looking at thousands of tests and their modules again and again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory):
    """Folder of a finished tiny run. Not to be changed."""
    from tests.e2e import runs

    return runs.train_tiny(tmp_path_factory.mktemp("tiny") / "run")


@pytest.fixture
def run_copy(tiny_run, tmp_path):
    """The same, to be changed."""
    return shutil.copytree(tiny_run, tmp_path / "copy")


@pytest.fixture(scope="session", autouse=True)
def cache_dir(tmp_path_factory):
    """Folder that stands in for the user's cache (SHES_CACHE_DIR) in this session, worker processes included."""
    path = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SHES_CACHE_DIR", str(path))
        patch.setattr(os, "fsync", lambda _: None)  # a third of a tiny run, and no test cuts the power
        yield path
