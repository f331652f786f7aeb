"""Comparisons of a study's variants with the base and with each other: means, intervals, tests, effect sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from shes.runs.progress_display import format_duration
from shes.runs.tables import Row
from shes.studies.design import StudyDesign
from shes.studies.equal_budget import compare_curves
from shes.studies.provenance_columns import PROVENANCE, joined
from shes.studies.significance import holm, interquartile_mean, mann_whitney, permutation_test, superiority
from shes.studies.study import Study
from shes.studies.study_tables import CellResults
from shes.types import F64Array
from shes.viewing.curves import confidence_interval

_Place = tuple[str, str, str]
"""Environment, group, variant."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The comparison of a variant with another one on a task: a row of `comparison.csv`."""

    group: str
    variant: str
    env: str
    measure: str
    """Column of `runs.csv` that is compared."""
    seeds: int
    score_mean: float
    score_low: float
    """Lower end of the 95 % t interval of the mean over seeds; the mean itself of a single seed."""
    score_high: float
    score_error: float | None = None
    """Standard error of the mean over seeds; None for a single seed."""
    score_iqm: float
    """Interquartile mean over seeds."""
    score_iqm_low: float
    """Lower end of its 95 % bootstrap interval."""
    score_iqm_high: float
    against_group: str | None = None
    """The other variant's group; None for the base itself."""
    against: str | None = None
    """The other variant; None for the base itself."""
    difference: float | None = None
    """Difference of the means, this variant minus the other."""
    p: float | None = None
    """Two-sided p of a permutation test of the difference of means; None if a variant has a single seed."""
    p_holm: float | None = None
    """`p` with Holm's correction for the comparisons of this group on this task."""
    mann_whitney_u: float | None = None
    """Mann-Whitney U of this variant: the pairs of seeds in which it exceeds the other one; ties count one half."""
    mann_whitney_p: float | None = None
    """Two-sided p of a Mann-Whitney U test, without correction."""
    superiority: float | None = None
    """Probability that a seed of this variant exceeds one of the other; 0.5 is no effect."""
    ratio: float | None = None
    """This variant's measure over the other's, the geometric mean over the seeds of both; None if it is not asked."""
    ratio_low: float | None = None
    """Lowest ratio of a seed."""
    ratio_high: float | None = None
    steps_span: float | None = None
    """Environment steps from the start to the earliest last evaluation of a run of both, with those of a transferred
    primitive."""
    steps_score: float | None = None
    """Mean test score over `steps_span`, 0 while a primitive is trained; None without test scores."""
    steps_score_against: float | None = None
    """The same of the other variant."""
    steps_p: float | None = None
    """Two-sided p of a permutation test of these two; None if a variant has a single seed."""
    steps_p_holm: float | None = None
    """`steps_p` with Holm's correction for the comparisons of this group on this task."""
    hours_span: float | None = None
    """The same over hours."""
    hours_score: float | None = None
    hours_score_against: float | None = None
    hours_p: float | None = None
    hours_p_holm: float | None = None
    success_mean: float | None = None
    """Mean success rate of the best checkpoints; None without evaluations."""
    success_error: float | None = None
    """Its standard error over seeds."""
    env_steps: float | None = None
    """Mean environment steps of a run, without those of a transferred primitive."""
    primitive_env_steps: float | None = None
    """Mean environment steps of the training of a transferred primitive; None without one."""
    hours: float | None = None
    """Mean time of a run, without that of a transferred primitive."""
    primitive_hours: float | None = None
    """Mean time of the training of a transferred primitive; None without one."""
    hardware: str | None = None
    versions: str | None = None
    commit: str | None = None

    def row(self) -> Row:
        """Return the columns of the row."""
        return asdict(self)

    def texts(self, design: StudyDesign) -> tuple[str, ...]:
        """Return the cells of its row in the table of a task."""
        is_of_base = self.against is None or (self.against_group, self.against) == design.base
        variant = design.label(self.variant) + ("" if is_of_base else f" (against {self._other(design)})")
        interval = f" [{self.score_low:.2f}, {self.score_high:.2f}]" if self.seeds > 1 else ""
        score = f"{self.score_mean:.2f}{interval}"
        last = "-" if self.p_holm is None else f"{self.p_holm:.4f}"
        if design.has_ratios:
            numbers = self.ratio, self.ratio_low, self.ratio_high
            last = "-" if None in numbers else "{:.2f} [{:.2f}, {:.2f}]".format(*numbers)
            if self.ratio is not None and self.ratio_low == self.ratio_high:  # of a single seed
                last = f"{self.ratio:.2f}"
        return self.group, variant, str(self.seeds), score, last

    def equal_texts(self, design: StudyDesign) -> tuple[str, ...] | None:
        """Return the row of the comparison over equal steps and equal time, one of which may be unknown; else None."""
        steps, time = "-", "-"
        if self.steps_span is not None:
            span = f"{self.steps_span / 1e6:.2f} M" if self.steps_span >= 1e5 else f"{self.steps_span:,.0f}"
            scores = f"{self.steps_score:.2f} against {self.steps_score_against:.2f}"
            steps = f"{scores} in {span}{_p_text(self.steps_p_holm)}"
        if self.hours_span is not None:
            seconds = 3600 * self.hours_span
            span = format_duration(seconds) if seconds >= 10 else f"{seconds:.1f} s"
            scores = f"{self.hours_score:.2f} against {self.hours_score_against:.2f}"
            time = f"{scores} in {span}{_p_text(self.hours_p_holm)}"
        if steps == time:
            return None
        return self.group, f"{design.label(self.variant)} (against {self._other(design)})", steps, time

    def _other(self, design: StudyDesign) -> str:
        """Return the name of the other variant, with its group if that is not this one's."""
        group = "" if self.against_group == self.group else f"{self.against_group}, "
        return f"{group}{design.label(self.against or '')}"


def compare(study: Study, summaries: Mapping[str, CellResults]) -> list[Comparison]:
    """Return the comparisons of all variants with a finished run: with the base of their task, and in pairs."""
    design, runs = study.design, dict[_Place, list[CellResults]]()
    for cell in study.cells:
        if cell.name in summaries and cell.env in design.metrics:
            runs.setdefault((cell.env, cell.group, cell.variant), []).append(summaries[cell.name])
    scores = {
        place: np.array([run.row[design.metrics[place[0]].column] for run in found]) for place, found in runs.items()
    }
    found: list[Comparison] = []
    for env in design.metrics:
        for group in design.groups:
            variants = {variant: v for (e, g, variant), v in scores.items() if (e, g) == (env, group)}
            others = {place[1:]: v for place, v in scores.items() if place[0] == env}
            own = _compare_group(design, group, env, variants, others)
            found += _corrected([replace(each, **_facts(design, each, runs)) for each in own])
    return found


def _corrected(found: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons of a group on a task with their p values corrected by Holm's method."""
    columns = [holm([getattr(each, name) for each in found]) for name in ("p", "steps_p", "hours_p")]
    return [
        replace(each, p_holm=p, steps_p_holm=of_steps, hours_p_holm=of_hours)
        for each, p, of_steps, of_hours in zip(found, *columns, strict=True)
    ]


def _p_text(p: float | None) -> str:
    """Return a p value after a comma; nothing if there is none."""
    return "" if p is None else f", p {p:.4f}"


def _facts(design: StudyDesign, found: Comparison, runs: Mapping[_Place, Sequence[CellResults]]) -> dict[str, Any]:
    """Return the facts of the runs of a variant, and how they compare with another's beside the scores."""
    own = runs[found.env, found.group, found.variant]
    other = None
    if found.against is not None and found.against_group is not None:
        other = runs[found.env, found.against_group, found.against]
    rows, firsts = [run.row for run in own], [run.curve[0] for run in own if run.curve]
    facts = {
        "success_mean": _mean(success := _known(rows, "best_success")),
        "success_error": _standard_error(success),
        "env_steps": _mean(_known(rows, "env_steps")),
        "primitive_env_steps": _mean(_known(firsts, "primitive_env_steps")),
        "hours": _mean(_known(rows, "seconds"), unit=3600),
        "primitive_hours": _mean(_known(firsts, "primitive_seconds"), unit=3600),
        **{name: joined(run.row.get(name) for run in own) for name in PROVENANCE},
    }
    if other is not None and design.has_ratios:
        facts |= _ratios(own, other, design.metrics[found.env].column)
    if other is not None and design.has_equal_budgets:
        facts |= _equal(own, other)
    return facts


def _ratios(own: Sequence[CellResults], other: Sequence[CellResults], column: str) -> dict[str, float]:
    """Return the ratios of a measure by the seeds of both; none if there are none, or one is not positive."""
    first, second = ({run.row["seed"]: run.row[column] for run in side} for side in (other, own))
    both = [(second[seed], first[seed]) for seed in first.keys() & second.keys()]
    if not both or any(value <= 0 for pair in both for value in pair):
        return {}
    ratios = np.array([ours / theirs for ours, theirs in both])
    mean = float(np.exp(np.log(ratios).mean()))
    return {"ratio": mean, "ratio_low": float(ratios.min()), "ratio_high": float(ratios.max())}


def _equal(own: Sequence[CellResults], other: Sequence[CellResults]) -> dict[str, float | None]:
    """Return the comparison of test scores over equal environment steps, and over equal time."""
    facts: dict[str, float | None] = {}
    for name, x, unit in (("steps", "env_steps", 1), ("hours", "seconds", 3600)):
        if (found := compare_curves(other, own, x)) is not None:
            facts |= {
                f"{name}_span": found.span / unit,
                f"{name}_score": float(found.second.mean()),
                f"{name}_score_against": float(found.first.mean()),
                f"{name}_p": found.p,
            }
    return facts


def _known(rows: Sequence[Row], name: str) -> list[float]:
    """Return the values of a column that are known."""
    return [row[name] for row in rows if row.get(name) is not None]


def _mean(values: Sequence[float], unit: float = 1) -> float | None:
    """Return the mean of a sample in `unit`; None if it is empty."""
    return float(np.mean(values)) / unit if values else None


def _standard_error(values: Sequence[float] | F64Array) -> float | None:
    """Return the standard error of the mean of a sample; None if it has less than two values."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None


def _compare_group(
    design: StudyDesign,
    group: str,
    env: str,
    variants: Mapping[str, F64Array],
    others: Mapping[tuple[str, str], F64Array],
) -> list[Comparison]:
    """Return the comparisons of a group's variants with `others` of the same task."""
    pairs: list[tuple[str, tuple[str, str] | None]] = []
    for variant in variants:
        is_alone = (group, variant) == design.base or design.base not in others
        pairs.append((variant, None if is_alone else design.base))
    pairs += [
        (second[1], first)
        for first, second in (*design.paired, *design.paired_on.get(env, ()))
        if second[0] == group and second[1] in variants and first in others
    ]
    tests = [
        None
        if place is None or min(len(variants[variant]), len(others[place])) < 2
        else permutation_test(variants[variant], others[place])
        for variant, place in pairs
    ]
    found: list[Comparison] = []
    for (variant, place), p in zip(pairs, tests, strict=True):
        values, other = variants[variant], None if place is None else others[place]
        effect = None if p is None or other is None else superiority(other, values)
        low, high = confidence_interval(values[:, None])
        iqm, iqm_low, iqm_high = interquartile_mean(values)
        found.append(
            Comparison(
                group=group,
                variant=variant,
                env=env,
                measure=design.metrics[env].column,
                seeds=len(values),
                score_mean=float(values.mean()),
                score_low=float(low[0]),
                score_high=float(high[0]),
                score_error=_standard_error(values),
                score_iqm=iqm,
                score_iqm_low=iqm_low,
                score_iqm_high=iqm_high,
                against_group=None if place is None else place[0],
                against=None if place is None else place[1],
                difference=None if other is None else float(values.mean() - other.mean()),
                p=p,
                mann_whitney_u=None if effect is None or other is None else effect * len(values) * len(other),
                mann_whitney_p=None if p is None or other is None else mann_whitney(other, values),
                superiority=effect,
            )
        )
    return found
