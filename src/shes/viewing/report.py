"""`shes report`: one HTML page of runs, with curves, results on fresh episodes, maps, videos and settings."""

from __future__ import annotations

import base64
import json
import logging
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from html import escape
from importlib.resources import files
from itertools import chain
from math import sqrt
from pathlib import Path
from string import Template
from typing import Annotated, Any

import numpy as np

from shes.errors import ShesError, import_extra
from shes.rollout.episodes import PARTS
from shes.runs.evaluate import Evaluation, evaluate
from shes.runs.listings import run_state
from shes.runs.make_config import make_config
from shes.runs.shipped import read_agent, shipped_name
from shes.settings import Ge, Shown, checked
from shes.storage import write_atomically
from shes.types import F64Array
from shes.viewing.curves import Group, RunData, confidence_interval, group_runs, read_runs, setting_text
from shes.viewing.render import check_target, render
from shes.viewing.report_figures import MOST_EPISODES, SECTIONS, Figure, curve_figure, panels_of, play_maps

logger = logging.getLogger("shes.report")
_MOST_SHOWN = 6
"""Groups that have a map and a video."""
_VIDEO_STEPS, _VIDEO_PIXELS = 150, 320
_STATE = ("env", "algorithm", "preset", "seed", "generation", "generations", "env_steps", "best_score", "state")
"""Fields of the state of a run that the report shows."""
_CURVES_HINT = (
    "A curve of several runs is their mean, its band a 95 % t interval over runs. Two runs are thin lines with their "
    "mean, and runs that hardly overlap are drawn singly. The band of a single run is two standard errors over the "
    "episodes of an evaluation."
)


@checked
def report(
    runs: Path | str | Sequence[Path | str],
    out: Path | str | None = None,
    *,
    episodes: Annotated[int, Ge(1)] = 20,
    seed: Annotated[int, Ge(0)] | None = None,
    num_workers: Annotated[int, Ge(0), Shown(flag="--workers")] = 0,
    video: bool = True,
    on_step: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a report of `runs`, one HTML page that needs no network; return its path.

    What cannot be read, or done with one of the runs, is noted in the report and logged. Runs are grouped as by `plot`.
    It needs plotly (extra report). Without a graphics card a video takes half a minute; --no-video omits them.

    shes report runs/seeds runs/other --out report.html

    Args:
        runs: Run folders, folders of runs, or names of shipped agents.
        out: Path of the page, .html. If none, report.html in the run folder; for several runs or a shipped agent, in
            the working directory.
        episodes: Number of fresh episodes on which the best checkpoint of each run is evaluated.
        seed: Seed of these episodes; derived from that of each run if none.
        num_workers: Worker processes; 0 is one for every core. Does not change results.
        video: Whether the report has videos.
        on_step: Called with the number of parts of the work that have begun, and their total.
    """
    read, errors = read_runs(runs, "report")
    is_one = len(read) == 1 and not shipped_name(read[0].folder.path)
    target = Path(out) if out is not None else (read[0].folder.path if is_one else Path()) / "report.html"
    check_target(target, [".html"])
    plotly = import_extra("plotly.offline", "a report needs plotly", "Install it: pip install 'shes[report]'.")
    groups = group_runs(read)
    shown = groups[:_MOST_SHOWN]
    total = len(read) + len(shown) * (1 + video)
    parts = iter(range(1, total + 1))

    def begin_part() -> None:
        if on_step is not None:
            on_step(next(parts), total)

    found: dict[str, Evaluation] = {}
    for run in read:
        begin_part()
        with _noting(run, "evaluation"):
            found[run.name] = evaluate(run.folder.path, episodes=episodes, num_workers=num_workers, seed=seed)
    maps = _maps(shown, begin_part, episodes, seed, has_videos=video)
    returns, diagnostics = (_curves(title, groups) for title in SECTIONS)
    rest = [diagnostics, _timing(read), _settings(read), _origins(read)]
    notes = [f"{name} is left out: {error}" for name, error in errors.items()]
    body = [_runs(groups, notes), _results(groups, found, episodes), returns, maps, *rest]
    envs = dict.fromkeys(run.config.run.env for run in read)
    title = read[0].name if len(read) == 1 else f"{len(read)} runs of {', '.join(envs)}"
    made = f"Made on {datetime.now().astimezone():%d %B %Y, %H:%M}."
    template = Template((files("shes.viewing") / "report_page.html").read_text(encoding="utf-8"))
    program = plotly.get_plotlyjs().replace("</script", "<\\/script")
    whole = {"title": escape(f"Report: {title}"), "subtitle": made, "body": "\n".join(body), "plotly": program}
    text = template.substitute(whole)
    write_atomically(target, lambda file: file.write(text.encode(errors="replace")))
    return target


@contextmanager
def _noting(run: RunData, what: str) -> Iterator[None]:
    """Add the reason to the notes of the run if there is no `what`."""
    try:
        yield
    except ShesError as error:
        run.notes.append(f"There is no {what}: {error}")


def _results(groups: Sequence[Group], found: Mapping[str, Evaluation], episodes: int) -> str:
    """Return the results of each evaluated run, and of each group of several over the means of its runs."""
    rows: list[tuple[str, ...]] = []
    for group in groups:
        own = {run.name: [found[run.name]] for run in group.runs if run.name in found}
        if len(own) > 1:
            own = {group.label: [each for (each,) in own.values()], **own}
        rows += [(name, *_result_cells(each)) for name, each in own.items()]
    hint = (
        f"The best checkpoint of each run on {episodes} episodes that its training did not use: mean ± standard error "
        "over episodes, or over runs in the row of a group, and the 95 % interval of the mean (Student's t)."
    )
    headings = ("run", "score", "return", "success rate", "goals reached", "steps", "diverged")
    return _section("Fresh episodes", _paragraph(hint), _table(headings, rows)) if rows else ""


def _result_cells(found: Sequence[Evaluation]) -> list[str]:
    """Return the cells of one evaluation over its episodes, or of several over their means."""

    def sample(column: str) -> F64Array:
        values = [np.asarray(getattr(each, column), dtype=np.float64) for each in found]
        return values[0] if len(found) == 1 else np.array([each.mean() for each in values])

    has_goals = all(each.primitive_returns is not None for each in found)
    estimates = [estimate(sample(column)) for column in ("scores", "returns")]
    goals = estimate(sample("goals_reached")) if has_goals else "-"
    diverged = sum(int(each.diverged.sum()) for each in found)
    return [*estimates, f"{sample('successes').mean():.2f}", goals, f"{sample('steps').mean():.0f}", str(diverged)]


def estimate(values: F64Array) -> str:
    """Return mean, standard error and 95 % t interval of the mean of a sample, as text."""
    if len(values) < 2:
        return f"{values.mean():.2f}"
    error = values.std(ddof=1) / sqrt(len(values))
    (low,), (high,) = confidence_interval(values[:, None])
    return f"{values.mean():.2f} ± {error:.2f} [{low:.2f}, {high:.2f}]"


def _curves(title: str, groups: Sequence[Group]) -> str:
    """Return the section of curves `title`, with a figure for each environment."""
    found: list[str] = []
    for env in dict.fromkeys(group.runs[0].config.run.env for group in groups):
        own = [group for group in groups if group.runs[0].config.run.env == env]
        if panels := panels_of([run for group in own for run in group.runs], title):
            found += [f"<h3>{escape(env)}</h3>", _plot(f"{title} {env}", curve_figure(panels, own))]
    hint = _paragraph(_CURVES_HINT) if found and title == SECTIONS[0] else ""
    return _section(title, hint, *found)


def _maps(
    groups: Sequence[Group], begin_part: Callable[[], None], episodes: int, seed: int | None, *, has_videos: bool
) -> str:
    """Return maps and videos of the first run of each group, as far as they can be made."""
    cards: list[str] = []

    def add(title: str, content: str) -> None:
        cards.append(f'<div class="card"><h3>{escape(title)}</h3>{content}</div>')

    for run in (group.runs[0] for group in groups):
        begin_part()
        with _noting(run, "map"):
            maps = play_maps(run.folder.path, episodes, seed)
            for title, figure in zip(("", ": search for a way"), maps, strict=False):
                add(run.name + title, _plot(f"map {run.name}{title}", figure))
        if has_videos:
            begin_part()
            steps = min(_VIDEO_STEPS, run.config.evaluation_steps)
            with _noting(run, "video"), tempfile.TemporaryDirectory(prefix="shes-report-") as folder:
                out = render(run.folder.path, Path(folder) / "walk.mp4", size=_VIDEO_PIXELS, steps=steps, seed=seed)
                uri = f"data:video/mp4;base64,{base64.b64encode(out.read_bytes()).decode()}"
                add(run.name, f'<video controls loop muted playsinline src="{uri}"></video>')
    hint = (
        f"Paths of the best checkpoint in the first {min(episodes, MOST_EPISODES)} of these episodes, of one run of "
        f"each of the first {len(groups)} groups. A dot is the end of a path, a cross a goal. A video is the beginning "
        "of the first episode."
    )
    grid = "\n".join(['<div class="cards">', *cards, "</div>"])
    return _section("Maps and videos", _paragraph(hint), grid) if cards else ""


def _timing(runs: Sequence[RunData]) -> str:
    """Return the seconds of the parts of each run, and those that its workers spent, summed over them."""
    columns = dict.fromkeys(name for run in runs for name in run.tables["progress"] if name.endswith("_s"))
    names = [name for name in columns if name not in ("wall_time_s", "process_time_s", "env_steps_per_s")]
    rows: list[list[str]] = []
    for run in runs:
        progress = run.tables["progress"]
        if len(progress.get("wall_time_s", ())):
            spent = [f"{np.nansum(progress[name]):,.0f}" if name in progress else "-" for name in names]
            rows.append([run.name, f"{progress['wall_time_s'][-1]:,.0f}", *spent])
    words = [name.removesuffix("_s") for name in names]
    headings = ["run", "wall clock", *(f"{word} (in workers)" if word in PARTS else word for word in words)]
    return _section("Time in seconds", _table(headings, rows))


def _settings(runs: Sequence[RunData]) -> str:
    """Return the settings in which runs differ from each other or from their presets."""
    configs = {run.name: run.config for run in runs}
    for run in runs:
        env, preset, algorithm = run.config.run.env, run.config.run.preset, run.config.run.algorithm
        with _noting(run, "preset"):
            configs[f"preset {preset} of {algorithm} for {env}"] = make_config(env, preset, {"algorithm": algorithm})
    columns = [config.values for config in configs.values()]
    rows = [
        (name, *(setting_text(each[name]) if name in each else "-" for each in columns))
        for name in dict.fromkeys(chain(*columns))
    ]
    return _section("Settings that differ", _table(("setting", *configs), [row for row in rows if len({*row[1:]}) > 1]))


def _runs(groups: Sequence[Group], notes: list[str]) -> str:
    """Return the runs, and below `notes` those on what could not be done so far, which are logged, too."""
    rows: list[tuple[Any, ...]] = []
    for group in groups:
        for run in group.runs:
            state = run_state(run.folder)
            cells = [getattr(state, name) for name in _STATE]
            rows.append((run.name, group.label, *("-" if cell is None else setting_text(cell) for cell in cells)))
            notes += [f"{run.name}: {note}" for note in run.notes]
    for note in notes:
        logger.warning(note)  # on standard error, unless logging is set up
    headings = ("run", "group", *(name.replace("_", " ") for name in _STATE))
    return _section("Runs", _table(headings, rows), *(_paragraph(note, "note") for note in notes))


def _origins(runs: Sequence[RunData]) -> str:
    """Return the record of each run but for its settings: command, hardware, versions and commit."""
    parts: list[str] = []
    for run in runs:
        agent = shipped_name(run.folder.path)
        record = {name: value for name, value in run.folder.read_record().items() if name != "config"}
        record |= {"made by": read_agent(agent).commands} if agent else {}
        text = escape(json.dumps(record, indent=2, default=str))
        parts.append(f"<details><summary>{escape(run.name)}</summary>\n<pre>{text}</pre></details>")
    return _section("Hardware, versions and commands", *parts)


def _section(title: str, *parts: str) -> str:
    content = "\n".join(filter(None, parts))
    return f"<section>\n<h2>{escape(title)}</h2>\n{content}\n</section>" if content else ""


def _paragraph(text: str, kind: str = "hint") -> str:
    return f'<p class="{kind}">{escape(text)}</p>'


def _table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows]
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    whole = f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'
    return whole if lines else ""


def _plot(name: str, figure: Figure) -> str:
    """Return the data of the figure called `name`, and its place."""
    place, data = escape(name), json.dumps(figure, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" data-plot="{place}">{data}</script>\n<div class="plot" id="{place}"></div>'
