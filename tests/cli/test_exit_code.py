"""Output and exit codes: brackets are no markup, narrow or poor terminals show all, a closed pipe ends quietly."""

import io
import re
import signal
import subprocess
import sys
import threading

import pytest

from shes.cli import main
from shes.cli.program import BROKEN_PIPE, INTERRUPTED, exit_code
from shes.console import LineConsole
from shes.errors import ConfigError, WorkerError
from shes.types import Table
from tests.e2e import runs

BRACKETS = "[b]x[/b] [/q] pip install 'shes[robotics]'"


def test_brackets_are_shown_as_they_are(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    LineConsole().print_table(Table((), [(BRACKETS, BRACKETS)]))
    LineConsole().print_line(BRACKETS)
    assert capsys.readouterr().out.count(BRACKETS) == 3
    LineConsole(stderr=True).print_error(BRACKETS)
    assert capsys.readouterr().err == f"Error: {BRACKETS}\n"


def test_a_table_breaks_between_words_and_in_its_widest_column(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    rows = [("runs/" + "long-" * 9, "point-gather", "5.00 ± 0.11"), ("b", "ant-maze", "-")]
    LineConsole().print_table(Table(("run", "environment", "best score"), rows))
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert len(lines[0]) <= 50
    for word in ("environment", "point-gather", "ant-maze", "5.00", "score"):
        assert word in out
    joined = "".join(line.split("│")[1].strip() for line in lines if line.count("│") == 4)
    assert joined == rows[0][0] + "b"


def test_characters_that_an_encoding_lacks_are_replaced(monkeypatch):
    for encoding, text in (("ascii", "5.00 ? 0.50"), ("utf-8", "5.00 ± 0.50")):
        stream = io.TextIOWrapper(io.BytesIO(), encoding)
        monkeypatch.setattr(sys, "stdout", stream)
        assert exit_code(lambda: LineConsole().print_line("5.00 ± 0.50") or 0) == 0
        assert stream.buffer.getvalue().decode(encoding) == f"{text}\n"


def test_a_terminal_without_width_shows_tables_and_help(shes):
    for columns in (0, 1, 5):
        assert "agent" in shes("info", "ant-gather", columns=columns)
        assert "usage: shes watch" in " ".join(shes("watch", "--help", columns=columns).split())


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
        (lambda: main(["no-such-command"]), 2),
    ],
)
def test_a_closed_pipe_keeps_the_exit_code(monkeypatch, work, code):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, Broken())
    assert exit_code(work) == code


def test_memory_that_runs_out_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr("shes.cli.program.free_memory", lambda: 1e12)
    codes = [exit_code(fail(each)) for each in (MemoryError("9 TB"), ValueError("in C:\n9 TB: cannot allocate memory"))]
    monkeypatch.setattr("shes.cli.program.free_memory", lambda: 2e8)
    with pytest.raises(KeyError):  # a fault of ours has a traceback, also where memory is short
        exit_code(fail(KeyError()))
    assert [*codes, exit_code(fail(ImportError("9 TB")))] == [2, 2, 2]
    assert re.fullmatch(r"(Error: not enough memory \(9 TB.*\)\. Raise its limit, .*\n){3}", capsys.readouterr().err)


def test_a_thread_that_stays_does_not_keep_the_program(monkeypatch, capsys):
    ended = []
    for name, value in {"os._exit": ended.append, "shes.cli.program._END_S": 999, "sys.argv": ["shes", "none"]}.items():
        monkeypatch.setattr(name, value)
    assert main(["--version"]) == 0  # called by others, it ends nothing
    assert main() == 2
    (timer,) = (each for each in threading.enumerate() if isinstance(each, threading.Timer))
    timer.cancel()
    assert timer.daemon  # nor does it keep the program itself
    timer.function(*timer.args)
    assert (ended, "Ended, although a thread" in capsys.readouterr().err) == ([2], True)


TRAIN = ["train", "point-gather", *runs.flags(**{**runs.TINY, "generations": 2})]


def test_a_closed_pipe_ends_a_run_and_closed_streams_do_not(tmp_path):
    cases = {"pipe": ('"$@" | true; exit ${PIPESTATUS[0]}', BROKEN_PIPE), "closed": ('"$@" <&- >&- 2>&-', 0)}
    started = {}
    for name, (code, _) in cases.items():
        words = ["bash", "-c", code, "bash", *runs.COMMAND, *TRAIN, "--out", str(tmp_path / name)]
        started[name] = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for name, (_, expected) in cases.items():
        assert (*started[name].communicate(), started[name].returncode) == (b"", b"", expected)
    assert runs.state(tmp_path / "pipe").generation < 2 == runs.state(tmp_path / "closed").generation


def test_sigterm_ends_a_drawing_as_ctrl_c_does(monkeypatch, capsys):
    def draw(on_step=None):
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("shes.viewing.render.render", draw)
    assert main(["render"]) == INTERRUPTED
    assert capsys.readouterr().err == "Interrupted.\n"
