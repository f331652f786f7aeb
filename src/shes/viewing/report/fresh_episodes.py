"""The best checkpoint of each run on fresh episodes, with standard errors and intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np

from shes.errors import ShesError
from shes.runs.evaluate import Evaluation, evaluate
from shes.types import F64Array
from shes.viewing.curves import confidence_interval
from shes.viewing.report.reading import ReportedGroup, ReportedRun

_Z = 1.96  # of a 95 % interval
HEADINGS = ("run", "generation", "score", "return", "success rate", "goals reached", "steps", "diverged")


def evaluate_runs(
    runs: Sequence[ReportedRun],
    episodes: int,
    num_workers: int,
    seed: int | None,
    on_part: Callable[[], None],
) -> dict[str, Evaluation]:
    """Return the evaluation of each run's best checkpoint, by name; add to a run's notes why it has none."""
    found: dict[str, Evaluation] = {}
    for run in runs:
        on_part()
        try:
            found[run.name] = evaluate(run.folder.path, episodes=episodes, num_workers=num_workers, seed=seed)
        except ShesError as error:
            run.notes.append(f"It could not be evaluated: {error}")
    return found


def result_rows(groups: Sequence[ReportedGroup], found: dict[str, Evaluation]) -> list[tuple[str, ...]]:
    """Return a row for each evaluated run, and one for each group of several, over its runs. See `HEADINGS`."""
    rows: list[tuple[str, ...]] = []
    for group in groups:
        evaluated = [run for run in group.runs if run.name in found]
        if len(evaluated) > 1:
            rows.append(_group_row(group.title, [found[run.name] for run in evaluated]))
        rows += [_run_row(run, found[run.name]) for run in evaluated]
    return rows


def _run_row(run: ReportedRun, found: Evaluation) -> tuple[str, ...]:
    """Return the row of a run: its sample are the episodes."""
    successes, episodes = int(found.successes.sum()), len(found.scores)
    low, high = wilson(successes, episodes)
    return (
        run.name,
        str(_best_generation(run)),
        estimate(found.scores),
        estimate(found.returns),
        f"{successes / episodes:.2f} [{low:.2f}, {high:.2f}]",
        "-" if found.primitive_returns is None else estimate(found.goals_reached),
        f"{found.steps.mean():.0f}",
        str(int(found.diverged.sum())),
    )


def _group_row(label: str, found: Sequence[Evaluation]) -> tuple[str, ...]:
    """Return the row of a group: its sample are the means of its runs."""

    def over_runs(name: str) -> str:
        return estimate(np.array([getattr(each, name).mean() for each in found]))

    has_goals = all(each.primitive_returns is not None for each in found)
    return (
        label,
        "",
        over_runs("scores"),
        over_runs("returns"),
        over_runs("successes"),
        over_runs("goals_reached") if has_goals else "-",
        f"{np.mean([each.steps.mean() for each in found]):.0f}",
        str(int(sum(each.diverged.sum() for each in found))),
    )


def _best_generation(run: ReportedRun) -> int | str:
    """Return the generation of a run's best checkpoint."""
    try:
        return run.folder.load("best", with_state=False).generation
    except ShesError:
        return "-"


def estimate(values: F64Array) -> str:
    """Return mean, standard error and 95 % t interval of the mean of a sample, as text."""
    if len(values) < 2:
        return f"{values.mean():.2f}"
    error = values.std(ddof=1) / sqrt(len(values))
    (low,), (high,) = confidence_interval(values[:, None])
    return f"{values.mean():.2f} ± {error:.2f} [{low:.2f}, {high:.2f}]"


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate, which is no point even if all of the trials or none succeed.

    Source: Wilson (1927).
    """
    rate, weight = successes / trials, _Z**2 / trials
    middle = (rate + weight / 2) / (1 + weight)
    half = _Z / (1 + weight) * sqrt(rate * (1 - rate) / trials + weight / (4 * trials))
    return max(0.0, middle - half), min(1.0, middle + half)
