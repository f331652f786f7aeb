"""Runs of several kinds, to be reported and not to be changed."""

import pytest

from tests.e2e import runs


@pytest.fixture(scope="session")
def kinds(tmp_path_factory):
    """Folders of two repetitions, a run of another sigma, a flat one and a primitive alone, by name."""
    folder = tmp_path_factory.mktemp("kinds")
    return {
        "first": runs.train_tiny(folder / "seeds" / "first", seed=5),
        "second": runs.train_tiny(folder / "seeds" / "second", seed=6, generations=3),
        "other": runs.train_tiny(folder / "other", sigma=0.5),
        "flat": runs.train_tiny(folder / "flat", algorithm="es", generations=2),
        "flag": runs.train_tiny(folder / "flag", "point-flagrun", generations=2),
    }
