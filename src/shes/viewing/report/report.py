"""`shes report`: one HTML page of runs, with curves, results on fresh episodes, maps, videos and settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Annotated

from shes.checked import checked
from shes.errors import ConfigError
from shes.runs.shipped import shipped_name
from shes.settings import Ge, Shown
from shes.storage import write_atomically
from shes.viewing.report.curve_charts import X_AXES, line_look
from shes.viewing.report.experiment_charts import EXPERIMENT_AXES
from shes.viewing.report.page import check_plotly, page, toolbar
from shes.viewing.report.page_sections import Sections, num_parts
from shes.viewing.report.reading import ReportedGroup, ReportedRun, read_runs

_NAME = "report.html"


@checked
def report(
    runs: Path | str | Sequence[Path | str],
    out: Path | str | None = None,
    *,
    labels: str | Sequence[str] = (),
    episodes: Annotated[int, Ge(1)] = 20,
    seed: Annotated[int, Ge(0)] | None = None,
    num_workers: Annotated[int, Ge(0), Shown(flag="--workers")] = 0,
    video: bool = True,
    on_step: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a report of `runs`, one HTML page that needs no network.

    What cannot be read, or done with one of the runs, is noted in the report and logged. Runs are grouped as by `plot`.
    The folder of an experiment begins with its figures and comparisons, and its runs have the names of their groups and
    variants. It needs plotly (extra report). Without a graphics card a video takes half a minute; --no-video omits
    them.

    shes report runs/seeds runs/other --out report.html

    Args:
        runs: Run folders, folders of runs, folders of experiments, or names of shipped agents.
        out: Path of the page, .html. If none, report.html in the run folder; for several runs, an experiment or
            a shipped agent, in the working directory.
        labels: Label of each of the runs; those with the same label are a group.
        episodes: Number of fresh episodes on which the best checkpoint of each run is evaluated.
        seed: Seed of these episodes; derived from that of each run if none.
        num_workers: Worker processes; 0 is one for every core. Does not change results.
        video: Whether the report has videos.
        on_step: Called with the number of parts of the work that have begun, and their total.

    Returns:
        Path of the page.

    Raises:
        RunFolderError: A run is neither a folder of runs nor a shipped agent, or an experiment without a result, or
            none can be read.
        ConfigError: `runs` is empty, there is not one label for each, or another argument is out of range.
        MissingExtraError: plotly is not installed.
        StorageError: The page cannot be written.
    """
    given = [runs] if isinstance(runs, str | os.PathLike) else list(runs)
    read = read_runs(given, [labels] if isinstance(labels, str) else list(labels))
    target = _checked_path(out, [] if read.experiments else read.runs)
    check_plotly()
    parts, total = count(1), num_parts(read, has_videos=video)
    sections = Sections(read, lambda: on_step(min(next(parts), total), total) if on_step else None)
    experiments = toolbar(sections.experiments(), EXPERIMENT_AXES, has_legend=False)
    curves = sections.curves()
    results = sections.results(episodes, seed, num_workers)
    pictures = sections.pictures(episodes, seed, has_videos=video)
    settings = sections.settings()
    runs_and_notes = sections.runs()  # after all that may add a note
    body = (
        [experiments, runs_and_notes, results, pictures, sections.folded_curves(curves), settings]
        if read.experiments
        else [runs_and_notes, results, toolbar("\n".join([*curves[:2], pictures, *curves[2:]])), settings]
    )
    body.append(sections.origins())
    axes = {x: _looks(read.groups_over(x)) for x in X_AXES}
    made = f"Made on {datetime.now().astimezone():%d %B %Y, %H:%M}."
    text = page(_title(read.runs), made, body, sections.figures, axes)
    write_atomically(target, lambda file: file.write(text.encode(errors="replace")))
    return target


def _checked_path(out: Path | str | None, runs: Sequence[ReportedRun]) -> Path:
    """Return the path of the page; raise ConfigError if it cannot be one."""
    is_one = len(runs) == 1 and not shipped_name(runs[0].folder.path)
    home = runs[0].folder.path if is_one else Path()
    target = home / _NAME if out is None else Path(out)
    if target.suffix.lower() != ".html":
        raise ConfigError(f"out must end in .html, got {str(out)!r}. Set --out.")
    if target.is_dir():
        raise ConfigError(f"{target} is a folder. Choose another path with --out.")
    if not target.parent.is_dir():
        raise ConfigError(f"there is no folder {target.parent}. Create it, or choose another path with --out.")
    return target


def _title(runs: Sequence[ReportedRun]) -> str:
    if not runs:
        return "Report of an experiment"
    envs = ", ".join(dict.fromkeys(run.config.run.env for run in runs))
    return f"Report: {runs[0].name}" if len(runs) == 1 else f"Report: {len(runs)} runs of {envs}"


def _looks(groups: Sequence[ReportedGroup]) -> list[dict[str, str]]:
    """Return how the curves are to be found, each label once: label, colour and dash."""
    looks = {group.label: line_look(group) for group in groups}
    return [{"label": label, "color": color, "dash": dash} for label, (color, dash) in looks.items()]
