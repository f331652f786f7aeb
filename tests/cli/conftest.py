"""The command line, in this process."""

import pytest

from shes.cli import main


@pytest.fixture
def shes(capsys, monkeypatch):
    """Return a function that runs a command line that succeeds, and returns what it printed."""

    def run(*words, columns=80):
        monkeypatch.setenv("COLUMNS", str(columns))
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert (code, err) == (0, "")
        return out

    return run
