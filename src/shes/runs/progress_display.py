"""Live progress of a run in a terminal, or occasional lines elsewhere."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

from rich.console import Console, Group
from rich.live import Live
from rich.progress import Progress
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from shes.console import LineConsole
from shes.runs.config import TrainConfig
from shes.runs.recorder import AnyListener
from shes.runs.tables import Row

_LINE_EVERY_S = 10.0  # where nothing can be redrawn
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


@contextmanager
def with_display(listener: AnyListener, progress: bool | None) -> Iterator[AnyListener]:
    """Yield `listener`, with a progress display if `progress` is True, or None in a terminal or a notebook."""
    console = LineConsole()
    if not (console.is_terminal or console.is_jupyter if progress is None else progress):
        yield listener
        return
    with ProgressDisplay(console) as display:
        yield [display, listener]


class ProgressDisplay:
    """A listener that shows generation, returns of the levels, evaluation score, steps per second and time left."""

    def __init__(self, console: LineConsole) -> None:
        """Show on `console`; use as a context manager."""
        self.path: Path | None = None
        """The run folder, once there is one."""
        self._console = console
        can_redraw = console.is_terminal and not console.is_dumb_terminal
        self._live = Live(console=console, auto_refresh=False, transient=False) if can_redraw else None
        self._row: Row = {}
        self._evaluation: Row = {}
        self._events: deque[str] = deque(maxlen=3)
        self._shares: deque[tuple[float, float]] = deque(maxlen=_REMEMBERED)  # (time, share of the run)

    def __enter__(self) -> ProgressDisplay:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def on_start(self, path: Path, config: TrainConfig, generation: int, num_workers: int) -> None:
        """Print the environment, the workers and the run folder."""
        self.path, self._run = path, config.run
        self._start = self._last_line = monotonic()
        workers = f"{num_workers} worker{'s' * (num_workers != 1)}"
        if config.workers.device != "cpu":
            workers = f"device {config.workers.device}"
        elif config.workers.backend == "serial":
            workers = "this process"
        elif config.algorithm.learns_in_main_process:
            workers = f"this process, evaluating on {workers}"
        after = f" after generation {generation}" if generation else ""
        name, text = (config.run.env, "bold"), f" ({config.run.preset}) on {workers}{after}. Run folder: "
        self._console.print_line(Text.assemble("Training ", name, text, (str(path), "cyan")))

    def on_generation(self, row: Row) -> None:
        """Show a generation."""
        self._row, now, run = row, monotonic(), self._run
        shares = [row["generation"] / run.generations]  # of the limit that is reached first
        shares += [] if run.env_steps is None else [row["env_steps"] / run.env_steps]
        shares += [] if run.minutes is None else [(now - self._start) / (60 * run.minutes)]
        self._shares.append((now, min(1.0, max(shares))))
        is_last = run.is_over(row["generation"], row["env_steps"])
        self._redraw()
        if self._live is None and (now - self._last_line >= _LINE_EVERY_S or is_last or row["generation"] == 1):
            self._last_line = now
            self._console.print_line("  ".join(f"{name} {value}" for name, value in self._facts()))

    def on_evaluation(self, row: Row) -> None:
        """Show an evaluation, with the last generation; on a plain terminal the next line shows it."""
        self._evaluation = row
        self._redraw()

    def on_event(self, event: str) -> None:
        """Show a warning at once."""
        self._events.append(event)
        self._redraw()
        if self._live is None:
            self._console.print_line(Text(event, style="yellow"))

    def _time_left(self) -> str:
        (begin, before), (end, share) = self._shares[0], self._shares[-1]
        if share <= before:
            return "0 s" if share == 1 else "-"
        return format_duration((1 - share) * (end - begin) / (share - before))

    def _facts(self) -> list[tuple[str, str]]:
        row, found, score = self._row, self._evaluation, "-"
        if found:
            sign = "+/-" if self._console.options.ascii_only else "±"
            score = f"{found['score_mean']:.2f} {sign} {found['score_std']:.2f}"
        at_most = " at most" * (self._run.env_steps is not None or self._run.minutes is not None)
        levels = [column.removesuffix("_return_max") for column in row if column.endswith("_return_max")]
        return [
            ("generation", f"{row['generation']} / {self._run.generations}{at_most}"),
            *(
                (f"{it} return", f"{row[f'{it}_return_mean']:.2f} (best {row[f'{it}_return_max']:.2f})")
                for it in levels
            ),
            ("evaluation score", score),
            ("env steps", f"{row['env_steps']:,.0f}"),
            ("env steps/s", f"{row['env_steps_per_s']:,.0f}"),
            ("time left", self._time_left()),
        ]

    def _redraw(self) -> None:
        """Draw the block again, in a terminal that can; it fits 40 columns and uses up to 100."""
        if self._live is None:
            return
        parts: list[Table | Text] = [Text(event, style="yellow") for event in self._events]
        if self._row:
            table = Table.grid(padding=(0, 2))
            table.add_column(style="dim", no_wrap=True)
            table.add_column(no_wrap=True, overflow="ellipsis")
            for name, value in self._facts():
                table.add_row(Text(name), Text(value))
            bar = Table.grid()  # ends the line, which the bar alone does not
            width = min(self._console.width, 100)
            bar.add_row(ProgressBar(total=1000, completed=round(1000 * self._shares[-1][1]), width=width))
            parts = [bar, table, *parts]
        self._live.update(Group(*parts), refresh=True)
