"""Live progress of a run in a terminal, or occasional lines elsewhere."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress import Progress
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from shes.console import LineConsole
from shes.runs.config import TrainConfig
from shes.runs.listening import AnyListener

__all__ = ["ProgressDisplay", "drawing_progress", "format_duration", "shown_beside"]

Row = dict[str, Any]

_BLOCKS, _ASCII_BLOCKS = "▁▂▃▄▅▆▇█", "_.-:=+*#"
_LINE_EVERY_S = 10.0  # if not in a terminal; in one that cannot redraw, every generation is a line
_REMEMBERED = 20  # generations from which the time left is estimated


def format_duration(seconds: float) -> str:
    """Return a duration as text: `45 s`, `3 min 05 s`, `2 h 10 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


@contextmanager
def drawing_progress(console: Console, name: str = "drawing") -> Iterator[Callable[[int, int], None]]:
    """Yield a function of the control steps drawn and of their total, which shows the progress in a terminal."""
    is_silent = not console.is_terminal or console.is_dumb_terminal
    with Progress(console=console, transient=True, disable=is_silent) as progress:
        task = progress.add_task(name, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _sparkline(values: list[float], width: int, blocks: str) -> str:
    """Return a line chart of `values` of at most `width` characters, drawn with `blocks` of rising height."""
    if len(values) < 2:
        return ""
    step = max(1, -(-len(values) // width))
    shown = [sum(values[i : i + step]) / len(values[i : i + step]) for i in range(0, len(values), step)]
    low, high = min(shown), max(shown)
    scale = (len(blocks) - 1) / (high - low) if high > low else 0
    return "".join(blocks[round((value - low) * scale)] for value in shown)


class ProgressDisplay:
    """A `Listener` that shows generation, returns of both levels, evaluation score, steps per second and time left."""

    def __init__(self, console: Console) -> None:
        """Show on `console`; use as a context manager."""
        self.path: Path | None = None
        """The run folder, once there is one."""
        self._console = console
        self._is_ascii = console.options.ascii_only
        can_redraw = console.is_terminal and not console.is_dumb_terminal
        self._live = Live(console=console, auto_refresh=False, transient=False) if can_redraw else None
        self._line_every_s = 0.0 if console.is_terminal else _LINE_EVERY_S
        self._config: TrainConfig | None = None
        self._row: Row = {}
        self._evaluation: Row = {}
        self._scores: list[float] = []
        self._events: deque[str] = deque(maxlen=3)
        self._times: deque[float] = deque(maxlen=_REMEMBERED)
        self._start = self._last_line = monotonic()

    def __enter__(self) -> ProgressDisplay:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def on_start(self, path: Path, config: TrainConfig, generation: int, num_workers: int) -> None:
        """Print the environment, the workers and the run folder."""
        self.path, self._config = path, config
        self._start = monotonic()
        workers = (
            f"{num_workers} worker{'s' * (num_workers != 1)}" if config.workers.backend != "serial" else "this process"
        )
        if config.algorithm.shares_memory and config.workers.backend != "serial":
            workers = f"this process, evaluating on {workers}"
        if config.workers.device != "cpu":
            workers = f"device {config.workers.device}"
        after = f" after generation {generation}" if generation else ""
        text = Text.assemble(
            "Training ",
            (config.run.env, "bold"),
            f" ({config.run.preset}) on {workers}{after}. Run folder: ",
            (str(path), "cyan"),
        )
        self._console.print(text, highlight=False, soft_wrap=True)

    def on_generation(self, row: Row) -> None:
        """Show a generation."""
        self._row = row
        self._times.append(monotonic())
        is_last = self._config is not None and self._config.run.is_over(row["generation"], row["env_steps"])
        if self._live is not None:
            self._live.update(self._view(), refresh=True)
        elif monotonic() - self._last_line >= self._line_every_s or is_last or row["generation"] == 1:
            self._last_line = monotonic()
            self._console.print(self._line(), highlight=False, soft_wrap=True)

    def on_evaluation(self, row: Row) -> None:
        """Show an evaluation, with the last generation; on a plain terminal the next line shows it."""
        self._evaluation = row
        if math.isfinite(row["score_mean"]):  # a task of one's own may have a score of NaN
            self._scores.append(row["score_mean"])
        if self._live is not None and self._row:
            self._live.update(self._view(), refresh=True)

    def on_event(self, event: str) -> None:
        """Show a warning at once."""
        self._events.append(event)
        if self._live is not None:
            self._live.update(self._view(), refresh=True)
        else:
            self._console.print(event, style="yellow", highlight=False, markup=False, soft_wrap=True)

    def _seconds_left(self) -> float | None:
        """Return the seconds left, estimated from the last generations; None before the second generation."""
        config = self._config
        if config is None or len(self._times) < 2:
            return None
        pace = (self._times[-1] - self._times[0]) / (len(self._times) - 1)
        left = pace * (config.run.generations - self._row["generation"])
        if config.run.env_steps is not None:
            generations = (
                (config.run.env_steps - self._row["env_steps"]) / self._row["env_steps"] * self._row["generation"]
            )
            left = min(left, max(0.0, pace * generations))
        if config.run.minutes is not None:
            left = min(left, max(0.0, 60 * config.run.minutes - (monotonic() - self._start)))
        return left

    def _facts(self) -> list[tuple[str, str]]:
        """Return the names and values shown."""
        row, evaluation = self._row, self._evaluation
        left = self._seconds_left()
        score = "-"
        if evaluation:
            plus_minus = "+/-" if self._is_ascii else "±"
            score = f"{evaluation['score_mean']:.2f} {plus_minus} {evaluation['score_std']:.2f}"
        run = self._config.run if self._config else None
        total = run.generations if run else 0
        has_other_limit = run is not None and (run.env_steps is not None or run.minutes is not None)
        names = [column.removesuffix("_return_max") for column in row if column.endswith("_return_max")]
        return [
            ("generation", f"{row['generation']} / {total}{' at most' * has_other_limit}"),
            *(
                (f"{name} return", f"{row[f'{name}_return_mean']:.2f} (best {row[f'{name}_return_max']:.2f})")
                for name in names
            ),
            ("evaluation score", score),
            ("env steps/s", f"{row['env_steps_per_s']:,.0f} ({row['env_steps'] / 1e6:,.1f} M so far)"),
            ("time left", "-" if left is None else format_duration(left)),
        ]

    def _line(self) -> Text:
        return Text("  ".join(f"{name} {value}" for name, value in self._facts()))

    def _view(self) -> Group:
        """Return the redrawn block; it fits 40 columns and uses up to 100."""
        events = [Text(event, style="yellow") for event in self._events]
        if not self._row:  # before the first generation
            return Group(*events)
        width = min(self._console.width, 100)
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis")
        for name, value in self._facts():
            table.add_row(Text(name), Text(value))
        course = _sparkline(self._scores, max(10, width - 22), _ASCII_BLOCKS if self._is_ascii else _BLOCKS)
        if course:
            table.add_row("score so far", Text(course, style="green"))
        total = self._config.run.generations if self._config else 1
        done = self._row["generation"]
        if self._config is not None:
            config, shares = self._config, [done / total]
            if config.run.env_steps is not None:
                shares.append(self._row["env_steps"] / config.run.env_steps)
            if config.run.minutes is not None:
                shares.append((monotonic() - self._start) / (60 * config.run.minutes))
            total, done = 1000, round(1000 * min(1.0, max(shares)))
        bar = Table.grid()  # ends the line, which the bar alone does not
        bar.add_row(ProgressBar(total=total, completed=done, width=width))
        return Group(bar, table, *events)


@contextmanager
def shown_beside(listener: AnyListener, progress: bool | None) -> Iterator[AnyListener]:
    """Yield `listener`, beside a progress display if `progress` is True, or None in a terminal or a notebook."""
    console = LineConsole()
    if not (console.is_terminal or console.is_jupyter if progress is None else progress):
        yield listener
        return
    with ProgressDisplay(console) as display:
        yield [display, *(listener if isinstance(listener, list | tuple) else () if listener is None else (listener,))]
