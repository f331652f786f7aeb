"""A run that the tests of this folder look at."""

import shutil

import pytest

from tests.e2e import runs


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory):
    """Folder of a finished tiny run. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("tiny") / "run")


@pytest.fixture
def run_copy(tiny_run, tmp_path):
    """The same, to be changed."""
    return shutil.copytree(tiny_run, tmp_path / "copy")
