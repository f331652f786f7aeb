"""The sections of a report."""

from __future__ import annotations

import logging
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from shes.drawing.opengl import find_opengl
from shes.errors import ShesError
from shes.runs.evaluate import Evaluation
from shes.runs.shipped import read_agent, shipped_name
from shes.viewing.report.configuration import changed_settings, differing_settings
from shes.viewing.report.curve_charts import SECTIONS, X_AXES, Figure, constants, curve_figure, panels_of
from shes.viewing.report.experiment_page import experiment_section
from shes.viewing.report.fresh_episodes import HEADINGS, evaluate_runs, result_rows
from shes.viewing.report.maps import MOST_EPISODES, episode_names, map_figure, play_episodes, search_figure
from shes.viewing.report.page import cards, details, map_card, paragraph, plots, section, table, toolbar, video_card
from shes.viewing.report.reading import ReportedGroup, ReportedRun, ReportedRuns
from shes.viewing.report.timing import time_figures
from shes.viewing.report.videos import video_uri

logger = logging.getLogger("shes.report")
_T = TypeVar("_T")

_MOST_SHOWN = 6
"""Groups that have a map and a video."""
_MOST_SHOWN_OF_EXPERIMENTS = 16
"""The same of experiments: two for each of eight environments."""
_SPEED = len(SECTIONS) - 1
_ORIGIN = ("environment", "algorithm", "preset", "seed")
_STATE_HEADINGS = (*_ORIGIN, "generation", "steps", "time", "best evaluation", "state")
_BANDS = (
    "A curve of several runs is their mean, its band a 95 % t interval over runs; two runs are thin lines beside their "
    "mean, and runs that hardly overlap are drawn singly. The band of a single run's evaluation is two standard errors "
    "over episodes wide on either side."
)


class Sections:
    """Makes the sections, as HTML, and collects their figures."""

    def __init__(self, read: ReportedRuns, on_part: Callable[[], None]) -> None:
        self.read = read
        self.figures: dict[str, Figure | dict[str, Figure]] = {}
        """Figures of the sections made so far; one for each of `X_AXES` if it depends on the horizontal axis."""
        self._on_part = on_part
        self._evaluated: dict[str, Evaluation] = {}

    def results(self, episodes: int, seed: int | None, num_workers: int) -> str:
        """Return the results on fresh episodes."""
        self._evaluated = evaluate_runs(self.read.runs, episodes, num_workers, seed, self._on_part)
        shown = table(HEADINGS, result_rows(self.read.groups, self._evaluated), "figures runs")
        hint = (
            f"The best checkpoint of each run on {episodes} episodes that its training did not use: mean ± standard "
            "error over episodes, or over runs in the row of a group, and the 95 % interval of the mean (Student's t; "
            "of the success rate of a run: Wilson)."
        )
        folded = self._folded(f"Results of {_counted(len(self._evaluated), 'run')}", shown)
        return section("Fresh episodes", paragraph(hint, "hint"), folded) if shown else ""

    def curves(self) -> list[str]:
        """Return a section for each of `SECTIONS`."""
        names: dict[int, list[str]] = {number: [] for number in range(len(SECTIONS))}
        envs = dict.fromkeys(run.config.run.env for run in self.read.runs)
        for env in envs:
            groups = {x: _groups_in(env, self.read.groups_over(x)) for x in X_AXES}
            beside = env if len(envs) > 1 else ""
            for panel in panels_of([run for run in self.read.runs if run.config.run.env == env]):
                name = f"{beside} {panel.table} {panel.column}".strip()
                names[panel.section].append(name)
                self.figures[name] = {x: curve_figure(panel, own, x, beside) for x, own in groups.items()}
        shares = {f"time {number}": figure for number, figure in enumerate(time_figures(self.read.groups))}
        self.figures.update(shares)
        fixed = ", ".join(f"{name} {' or '.join(values)}" for name, values in constants(self.read.runs).items())
        hints = {0: _BANDS, 2: f"Constant: {fixed}." if fixed else ""}
        return [
            section(
                title,
                paragraph(hints[number], "hint") if names[number] and hints.get(number) else "",
                plots(names[number]),
                plots(shares) if number == _SPEED else "",
            )
            for number, title in enumerate(SECTIONS)
        ]

    def folded_curves(self, curves: Sequence[str]) -> str:
        """Return the sections of curves beside an experiment's own, shown on demand."""
        curves = [each for each in curves if each]
        return details("Curves of the runs", toolbar("\n".join(curves)), is_heading=True) if curves else ""

    def pictures(self, episodes: int, seed: int | None, *, has_videos: bool) -> str:
        """Return maps and videos of the first run of each group that could be evaluated, as far as they can be made."""
        maps: list[str] = []
        videos: list[str] = []
        shown = _shown_groups(self.read)
        for number, group in enumerate(shown):
            run = next((run for run in group.runs if run.name in self._evaluated), group.runs[0])
            subtitle = group.label if len(self.read.groups) > 1 and run.place is None else ""
            self._on_part()
            journeys = _attempt(run, "map", lambda run=run: play_episodes(run.folder.path, episodes, seed))
            if journeys is not None:
                name = f"map {number}"
                self.figures[name] = map_figure(journeys)
                maps.append(map_card(name, run.name, subtitle, episode_names(journeys)))
                if journeys.explored is not None:
                    name = f"search {number}"
                    self.figures[name] = search_figure(journeys.explored, journeys)
                    maps.append(map_card(name, run.name, "Places that the search for a way reached, and its waypoints"))
            if has_videos:
                self._on_part()
                uri = _attempt(run, "video", lambda run=run: video_uri(run, seed))
                videos += [] if uri is None else [video_card(run.name, subtitle, uri)]
        some = (
            f" Shown are {len(shown)} of {len(self.read.groups)} groups: the first one of each environment, then the "
            "second ones, and so on."
            if len(self.read.groups) > len(shown)
            else ""
        )
        where = (
            f"Paths and goals of the best checkpoint in the first {min(episodes, MOST_EPISODES)} of these episodes, of "
            f"one run of each group.{some} A dot is the end of a path, a cross a goal. "
            "A single episode is shown with what the task marks, such as food or a target."
        )
        flat = " Drawn flat, from above: there is no OpenGL here." if videos and find_opengl() is None else ""
        what = f"The beginning of the first of these episodes.{some}{flat}"
        return "\n".join(
            [
                section("Map", paragraph(where, "hint"), cards(maps)) if maps else "",
                section("Video", paragraph(what, "hint"), cards(videos)) if videos else "",
            ]
        )

    def settings(self) -> str:
        """Return the settings in which groups differ, and those in which a run differs from its preset."""
        groups = self.read.groups
        parts: list[str] = []
        if self.read.experiments:
            envs = dict.fromkeys(run.config.run.env for run in self.read.runs)
            parts += [details(env, _differing(_groups_in(env, groups))) for env in envs]
        else:
            parts.append(_differing(groups))
        for group in groups:
            run = group.runs[0]
            changed = _attempt(run, "comparison with the preset", lambda run=run: changed_settings(run.config))
            if changed is None:
                continue
            preset = f"preset {run.config.run.preset} for {run.config.run.env}"
            rows = [(name, *values) for name, values in changed.items()]
            parts.append(
                details(
                    f"{run.name}: {len(rows)} settings differ from {preset}",
                    table(("setting", "run", "preset"), rows, "settings"),
                )
                or paragraph(f"{run.name}: as {preset}.")
            )
        return section("Settings", self._folded(f"Settings of {_counted(len(groups), 'group')}", "\n".join(parts)))

    def experiments(self) -> str:
        """Return the curves, figures and comparisons of the experiments."""
        found: list[str] = []
        for folder in self.read.experiments:
            try:
                text, figures = experiment_section(folder)
                found.append(text)
                self.figures.update(figures)
            except ShesError as error:
                self.read.left_out.append(f"An experiment is left out: {error}")
        return "\n".join(filter(None, found))

    def runs(self) -> str:
        """Return the runs, and the notes on what could not be done so far, which are logged, too."""
        groups = self.read.groups
        has_labels = len(groups) > 1 and not all(run.place for run in self.read.runs)
        rows = [
            (run.name, *([group.label] if has_labels else []), *_state(run)) for group in groups for run in group.runs
        ]
        headings = ("run", *(["group"] if has_labels else []), *_STATE_HEADINGS)
        notes = [*self.read.left_out, *(f"{run.name}: {note}" for run in self.read.runs for note in run.notes)]
        for note in notes:
            logger.warning(note)  # on standard error, unless logging is set up
        if self.read.experiments and not rows:  # as where its tables alone are kept
            notes.append("No folder of a run is here, so that evaluations, maps, videos and settings are not shown.")
        shown = self._folded(_counted(len(rows), "run"), table(headings, rows))
        return section("Runs", shown, *(paragraph(note, "note") for note in notes))

    def origins(self) -> str:
        """Return command, hardware, versions and commit of each run."""
        parts = [
            details(
                run.name,
                table(("fact", "value"), [row for row in _origin(run) if row[1] not in (None, "")], "settings"),
            )
            for run in self.read.runs
        ]
        folded = self._folded(f"Origin of {_counted(len(parts), 'run')}", "\n".join(parts))
        return section("Hardware, versions and commands", folded)

    def _folded(self, summary: str, content: str) -> str:
        """Return `content`; beside an experiment, whose results come first, it is shown on demand."""
        return details(summary, content) if self.read.experiments else content


def num_parts(read: ReportedRuns, *, has_videos: bool) -> int:
    """Return how often `Sections` says that a part of its work begins: evaluations, maps and videos."""
    return len(read.runs) + len(_shown_groups(read)) * (1 + has_videos)


def _shown_groups(read: ReportedRuns) -> list[ReportedGroup]:
    """Return the groups that have a map and a video."""
    return _first_of_each_env(read.groups)[: _MOST_SHOWN_OF_EXPERIMENTS if read.experiments else _MOST_SHOWN]


def _counted(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


def _differing(groups: Sequence[ReportedGroup]) -> str:
    """Return the settings in which `groups` differ; empty if there are none."""
    rows = [(name, *row) for name, row in differing_settings(groups).items()]
    return table(("setting", *(group.label for group in groups)), rows, "settings")


def _attempt(run: ReportedRun, what: str, make: Callable[[], _T]) -> _T | None:
    """Return what `make` returns; if it cannot, add the reason to the notes of the run and return None."""
    try:
        return make()
    except ShesError as error:
        run.notes.append(f"There is no {what}: {error}")
        return None


def _state(run: ReportedRun) -> tuple[Any, ...]:
    """Return the cells of `_STATE_HEADINGS` for a run."""
    state, times = run.state, run.tables["progress"].get("wall_time_s")
    end = "-" if times is None else _duration(float(times[-1]))
    origin = (state.env, state.algorithm, state.preset, state.seed)
    score = "-" if state.best_score is None else f"{state.best_score:.2f}"
    return (*origin, *_progress(run), end, score, state.state)


def _progress(run: ReportedRun) -> tuple[str, str]:
    """Return generation and environment steps of a run, with the limit of the one that is nearer to its own."""
    generation, steps = run.state.generation or 0, run.state.env_steps or 0
    most, most_steps = run.config.run.generations, run.config.run.env_steps
    if most_steps is not None and steps / most_steps >= generation / most:
        return str(generation), f"{steps:,} of {most_steps:,}"
    return f"{generation} of {most}", f"{steps:,}"


def _groups_in(env: str, groups: Sequence[ReportedGroup]) -> list[ReportedGroup]:
    """Return the groups with their runs in environment `env`, without those that have none."""
    own = [replace(group, runs=[run for run in group.runs if run.config.run.env == env]) for group in groups]
    return [group for group in own if group.runs]


def _first_of_each_env(groups: Sequence[ReportedGroup]) -> list[ReportedGroup]:
    """Return the groups in an order in which the first one of every environment comes before all second ones."""
    seen = Counter[str]()
    place: dict[int, int] = {}
    for number, group in enumerate(groups):
        env = group.runs[0].config.run.env
        place[number] = seen[env]
        seen[env] += 1
    return [groups[number] for number in sorted(place, key=place.__getitem__)]


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if seconds < 120 else f"{minutes // 60}:{minutes % 60:02} h"


def _origin(run: ReportedRun) -> list[tuple[str, Any]]:
    """Return what is known of the origin of a run."""
    agent = shipped_name(run.folder.path)
    commands = read_agent(agent).commands if agent else ()
    rows: list[tuple[str, Any]] = [("made by", command) for command in commands]
    parts = [run.record, *run.record.get("resumed", [])]
    for part in parts:
        if "generation" in part:
            rows.append(("resumed after generation", part["generation"]))
        rows += [
            ("started", part.get("started")),
            ("command", shlex.join(part.get("command", []))),
            ("machine", _facts(part.get("machine", {}))),
            ("device", _facts(part.get("device", {}))),
            ("versions", _facts(part.get("versions", {}))),
            ("commit", part.get("git_commit")),
        ]
    return rows


def _facts(facts: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items() if value is not None)
