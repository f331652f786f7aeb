"""Comparisons of a study's variants with the base and with each other: means, intervals, tests, effect sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from shes.runs.tables import Row
from shes.studies.design import StudyDesign
from shes.studies.provenance_columns import PROVENANCE, joined
from shes.studies.significance import holm, interquartile_mean, mann_whitney, permutation_test, superiority
from shes.studies.study import Study
from shes.studies.study_tables import CellResults
from shes.types import F64Array
from shes.viewing.curves import confidence_interval


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
    """Two-sided p of a permutation test of the difference of means."""
    p_holm: float | None = None
    """`p` with Holm's correction for the comparisons of this group on this task."""
    mann_whitney_p: float | None = None
    """Two-sided p of a Mann-Whitney U test, without correction."""
    superiority: float | None = None
    """Probability that a seed of this variant exceeds one of the other; 0.5 is no effect."""
    success_mean: float | None = None
    """Mean success rate of the best checkpoints; None without evaluations."""
    success_error: float | None = None
    """Its standard error over seeds."""
    hours: float | None = None
    """Mean time of a run."""
    hardware: str | None = None
    versions: str | None = None
    commit: str | None = None

    def row(self) -> Row:
        """Return the columns of the row."""
        return asdict(self)

    def texts(self, design: StudyDesign) -> tuple[str, ...]:
        """Return the cells of its row in the table of a task."""
        other = ""
        if self.against is not None and (self.against_group, self.against) != design.base:
            group = "" if self.against_group == self.group else f"{self.against_group}, "
            other = f" (to {group}{design.label(self.against)})"
        score = f"{self.score_mean:.2f} [{self.score_low:.2f}, {self.score_high:.2f}]"
        p = "-" if self.p_holm is None else f"{self.p_holm:.4f}"
        return self.group, design.label(self.variant) + other, str(self.seeds), score, p


def compare(study: Study, summaries: Mapping[str, CellResults]) -> list[Comparison]:
    """Return the comparisons of all variants with a finished run: with the base of their task, and in pairs."""
    design, rows = study.design, dict[tuple[str, str, str], list[Row]]()
    for cell in study.cells:
        if cell.name in summaries and cell.env in design.metrics:
            rows.setdefault((cell.env, cell.group, cell.variant), []).append(summaries[cell.name].row)
    scores = {place: [row[design.metrics[place[0]].column] for row in found] for place, found in rows.items()}
    found: list[Comparison] = []
    for env in design.metrics:
        for group in design.groups:
            variants = {variant: np.array(v) for (e, g, variant), v in scores.items() if (e, g) == (env, group)}
            others = {place[1:]: np.array(v) for place, v in scores.items() if place[0] == env}
            found += _compare_group(design, group, env, variants, others)
    return [replace(each, **_facts(rows[each.env, each.group, each.variant])) for each in found]


def _facts(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the facts of the runs of a variant that are not compared."""
    success, seconds = (
        [row[name] for row in rows if row.get(name) is not None] for name in ("best_success", "seconds")
    )
    return {
        "success_mean": float(np.mean(success)) if success else None,
        "success_error": _standard_error(success),
        "hours": float(np.mean(seconds)) / 3600 if seconds else None,
        **{name: joined(row.get(name) for row in rows) for name in PROVENANCE},
    }


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
    """Return the comparisons of a group's variants with `others` of the same task, with Holm's correction."""
    pairs: list[tuple[str, tuple[str, str] | None]] = []
    for variant in variants:
        is_alone = (group, variant) == design.base or design.base not in others
        pairs.append((variant, None if is_alone else design.base))
    pairs += [
        (second[1], first)
        for first, second in design.paired
        if second[0] == group and second[1] in variants and first in others
    ]
    tests = [None if place is None else permutation_test(variants[variant], others[place]) for variant, place in pairs]
    corrected = iter(holm([p for p in tests if p is not None]))
    found: list[Comparison] = []
    for (variant, place), p in zip(pairs, tests, strict=True):
        values, other = variants[variant], None if place is None else others[place]
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
                p_holm=None if p is None else next(corrected),
                mann_whitney_p=None if other is None else mann_whitney(other, values),
                superiority=None if other is None else superiority(other, values),
            )
        )
    return found
