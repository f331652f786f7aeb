"""Live progress: everything that was promised, within the width of the terminal, or lines where there is none."""

import io
import math
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.cells import cell_len

from shes.console import LineConsole
from shes.runs.make_config import make_config
from shes.runs.progress_display import ProgressDisplay, format_duration

CONFIG = make_config("point-gather", "smoke", {"generations": 40})


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is told."""
    made = SimpleNamespace(now=1000.0)
    monkeypatch.setattr("shes.runs.progress_display.monotonic", lambda: made.now)
    return made


def row(generation):
    returns = {"controller_return_mean": -1.234, "controller_return_max": 3.0}
    returns |= {"primitive_return_mean": -12.34, "primitive_return_max": 98.76}
    return {"generation": generation, "env_steps": 12_345 * generation, "env_steps_per_s": 23_456.7, **returns}


def play(console, clock, config=CONFIG, generations=12, after=0):
    """Show the beginning of a run, two seconds a generation."""
    with ProgressDisplay(console) as display:
        display.on_start(Path("runs/a"), config, after, 2)
        for generation in range(1, generations + 1):
            clock.now += 2
            display.on_generation(row(generation))
            if generation == 1 or generation % 5 == 0:
                display.on_evaluation({"score_mean": generation / 2, "score_std": 0.5})
            if generation == 7:
                display.on_event("worker 123 died (exit code -9); 4 tasks are done again")


def terminal(width):
    return LineConsole(file=io.StringIO(), force_terminal=True, width=width, height=30)


def plain(width=80):
    return LineConsole(file=io.StringIO(), force_terminal=False, width=width, record=True)


def lines_of(console):
    """Return every line that a terminal was made to show, without colours, the last block last."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", console.file.getvalue())
    return [line for line in re.split(r"[\r\n]+", text) if line]


@pytest.mark.parametrize("width", [40, 120])
def test_a_terminal_shows_everything_within_its_width(clock, width):
    console = terminal(width)
    play(console, clock)
    first, *lines = lines_of(console)
    # This line the terminal wraps by itself, so that the path can be copied whole.
    assert first == "Training point-gather (smoke) on 2 workers. Run folder: runs/a"
    assert max(cell_len(line) for line in lines) <= width
    last = "\n".join(lines[-11:])
    for fact in (
        "generation         12 / 40",
        "controller return  -1.23 (best 3.00)",
        "primitive return   -12.34 (best 98.76)",
        "evaluation score   5.00 ± 0.50",
        "env steps          148,140",
        "env steps/s        23,457",
        "time left          56 s",
        "worker 123 died (exit code -9); 4 tasks",
    ):
        assert fact in last
    bar = lines[-10 if width == 40 else -9]
    assert cell_len(bar) == min(width, 100)
    assert set(bar) <= set("━╸╺")


def test_without_a_terminal_a_line_comes_every_ten_seconds(clock, monkeypatch):
    console = plain(width=40)
    play(console, clock, generations=40)
    first, *lines = console.export_text().splitlines()
    assert first.endswith("Run folder: runs/a")
    shown = [line for line in lines if line.startswith("generation")]
    assert [int(line.split()[1]) for line in shown] == [1, 6, 11, 16, 21, 26, 31, 36, 40]
    assert lines[0] == (
        "generation 1 / 40  controller return -1.23 (best 3.00)  primitive return -12.34 (best 98.76)  "
        "evaluation score -  env steps 12,345  env steps/s 23,457  time left -"
    )
    assert lines[-1].endswith("time left 0 s")
    assert "worker 123 died (exit code -9); 4 tasks are done again" in lines
    assert "\x1b" not in console.file.getvalue()
    monkeypatch.setenv("TERM", "dumb")  # a terminal that cannot redraw
    console = terminal(80)
    play(console, clock)
    shown = [number for number in range(1, 13) if f"generation {number} / 40" in console.file.getvalue()]
    assert shown == [1, 6, 11]


def test_a_terminal_without_plus_minus_and_blocks_shows_ascii(clock):
    file = io.TextIOWrapper(io.BytesIO(), "ascii", errors="strict")
    play(LineConsole(file=file, force_terminal=True, width=80, height=30), clock)
    file.flush()
    text = file.buffer.getvalue().decode("ascii")
    assert "5.00 +/- 0.50" in text


@pytest.mark.parametrize(("limit", "left"), [({"minutes": 1.0}, 60 - 22), ({"env_steps": 15 * 12_345}, 2 * (15 - 11))])
def test_time_left_is_that_to_the_limit_that_is_reached_first(clock, limit, left):
    console = plain()
    play(console, clock, make_config("point-gather", "smoke", {"generations": 40, **limit}), generations=11)
    last = console.export_text().splitlines()[-1]
    assert last.startswith("generation 11 / 40 at most  ")
    assert last.endswith(f"time left {left} s")


def test_the_first_line_tells_where_it_trains_and_from_when(clock):
    for settings, where in (({"backend": "serial"}, "this process"), ({"device": "warp-cpu"}, "device warp-cpu")):
        console = plain()
        play(console, clock, make_config("point-gather", "smoke", settings), generations=0, after=17)
        text = f"Training point-gather (smoke) on {where} after generation 17. Run folder: runs/a\n"
        assert console.export_text() == text


def test_levels_are_those_of_the_row_and_brackets_are_shown(clock):
    console = terminal(80)
    with ProgressDisplay(console) as display:
        display.on_start(Path("runs/[b] [/b] x"), CONFIG, 0, 1)
        display.on_event("pip install 'shes[robotics]' [/b]")  # at once, before the first generation
        assert lines_of(console)[-1] == "pip install 'shes[robotics]' [/b]"
        levels = {"[/b]_return_mean": 1.0, "[/b]_return_max": 2.0}
        display.on_generation({name: value for name, value in row(1).items() if "return" not in name} | levels)
        for score in (math.nan, 1.0, math.inf, 2.0):  # a task of one's own may have a score that is no number
            display.on_evaluation({"score_mean": score, "score_std": 0.5})
    text = "\n".join(lines_of(console))
    assert "Run folder: runs/[b] [/b] x" in text
    assert re.search(r"\[/b\] return +1\.00 \(best 2\.00\)", text)
    assert "controller return" not in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (185, "3 min 05 s"), (3600, "1 h 00 min"), (7805, "2 h 10 min")],
)
def test_durations_are_said_as_people_say_them(seconds, text):
    assert format_duration(seconds) == text
