"""The output as it is: brackets are no markup, an encoding without ± gets ASCII, and a closed pipe ends quietly."""

import io
import os
import subprocess
import sys

import pytest

from shes.cli import output
from shes.cli.program import BROKEN_PIPE, INTERRUPTED, TO_ASCII, exit_code, main
from shes.console import LineConsole
from shes.errors import ConfigError, WorkerError
from shes.types import Listing, Table, facts_listing
from tests.e2e import runs

BRACKETS = "[b]x[/b] [/q] pip install 'shes[robotics]'"


@pytest.mark.parametrize(
    ("text", "encoding", "shown"),
    [
        ("5.00 ± 0.50, 3 × 256", "ascii", "5.00 +/- 0.50, 3 x 256"),
        ("5.00 ± 0.50, 3 × 256 →", "latin-1", "5.00 ± 0.50, 3 × 256 ->"),
        ("5.00 ± 0.50", "utf-8", "5.00 ± 0.50"),
        ("Größe, 世", "ascii", "Gr??e, ?"),
        ("a\udcff", "utf-8", "a?"),  # a file name that is no UTF-8
    ],
)
def test_characters_that_an_encoding_lacks_are_shown_in_ascii(text, encoding, shown):
    assert text.encode(encoding, TO_ASCII).decode(encoding) == shown


def test_a_table_is_as_wide_as_its_text_in_ascii(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), "ascii", errors=TO_ASCII)
    monkeypatch.setattr(sys, "stdout", stream)
    output.show(Listing(None, [Table(("a", "b"), [("5 ± 1", "5"), ("5", "5 × 1")])]))
    stream.flush()
    lines = stream.buffer.getvalue().decode("ascii").splitlines()
    assert "| 5 +/- 1 | 5     |" in lines
    assert len({len(line) for line in lines}) == 1


def test_brackets_are_shown_as_they_are(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    output.show(facts_listing({BRACKETS: BRACKETS}))
    LineConsole().print_line(BRACKETS)
    LineConsole(stderr=True).print_error(BRACKETS)
    out, err = capsys.readouterr()
    assert out.count(BRACKETS) == 2 + 1
    assert err == f"Error: {BRACKETS}\n"


class Broken(io.StringIO):
    """A stream that nobody reads."""

    def write(self, text):
        raise BrokenPipeError


def fail(error):
    """Return work that raises `error`, with a note."""
    error.add_note("kept")

    def work():
        raise error

    return work


@pytest.mark.parametrize(
    ("work", "code"),
    [
        (lambda: LineConsole().print_line("a word"), BROKEN_PIPE),
        (lambda: LineConsole(stderr=True).print_error("a word"), BROKEN_PIPE),
        (fail(KeyboardInterrupt()), INTERRUPTED),
        (fail(ConfigError("wrong")), 2),
        (fail(WorkerError("lost")), 1),
    ],
)
def test_a_closed_pipe_keeps_the_exit_code(monkeypatch, work, code):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, Broken())
    assert exit_code(work) == code


def test_unwritable_output_does_not_hide_an_exit_code(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Broken())
    assert main(["no-such-command"]) == 2


def test_closed_streams_are_replaced(monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    assert exit_code(lambda: LineConsole().print_line("nobody reads it") or 7) == 7
    assert sys.stdin.read() == ""
    for name in ("stdin", "stdout", "stderr"):
        getattr(sys, name).close()


TRAIN = ["train", "point-gather", *runs.flags(**{**runs.TINY, "generations": 2})]


def test_a_run_into_a_closed_pipe_ends_quietly(tmp_path):
    read_end, write_end = os.pipe()
    os.close(read_end)
    words = [*runs.COMMAND, *TRAIN, "--out", str(tmp_path / "run")]
    done = subprocess.run(words, stdout=write_end, stderr=subprocess.PIPE, check=False)
    os.close(write_end)
    assert (done.returncode, done.stderr) == (BROKEN_PIPE, b"")
    assert runs.state(tmp_path / "run").generation < 2  # it can be resumed


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_a_run_with_closed_output_goes_on(tmp_path, closed):
    words = ["bash", "-c", f'"$@" {closed}', "bash", *runs.COMMAND, *TRAIN, "--out", str(tmp_path / "run")]
    done = subprocess.run(words, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert runs.state(tmp_path / "run").generation == 2


def test_a_run_whose_output_has_no_plus_minus_goes_on(tmp_path):
    words, ascii_only = [*runs.COMMAND, *TRAIN, "--out", str(tmp_path)], {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(words, capture_output=True, check=False, env=ascii_only)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "+/-" in done.stdout.decode("ascii")
