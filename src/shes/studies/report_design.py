"""The design of a study for its report: names in words and charts, in a file beside the tables of the study."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

from shes.storage import write_atomically
from shes.studies.design import CurvePanel, Curves, Speedup, StudyDesign
from shes.studies.speedup_figure import KINDS, authors_speedup, paper_line
from shes.studies.study import Study
from shes.viewing.report.experiment_design import (
    SUFFIX,
    DesignedChart,
    DesignedCurve,
    DesignedSpeedup,
    ExperimentDesign,
    Series,
    design_text,
)

_TITLES = {"ablation": "Ablation", "learning": "Learning changes", "table1": "Table I"}
_AXES = {"env_steps": "env_steps", "hours": "wall_time_s"}


def study_title(name: str) -> str:
    """Return the title of the study `name` in a report."""
    return _TITLES.get(name, name.replace("fig", "Figure "))


def write_report_design(name: str, study: Study, table: str, out: Path) -> Path:
    """Write the design of the study `name`, whose comparisons are in `table`.csv, into `out`; return its path."""
    path = out / f"{table}{SUFFIX}"
    text = design_text(report_design(name, study))
    write_atomically(path, lambda file: file.write(text.encode()))
    return path


def report_design(name: str, study: Study) -> ExperimentDesign:
    """Return what a report shows of the study `name`."""
    design = study.design
    variants: dict[str, dict[str, str]] = {}
    for cell in study.cells:
        variants.setdefault(cell.group, {})[cell.variant] = design.label(cell.variant)
    charts: list[DesignedChart] = []
    for panel in chain.from_iterable(each.panels for each in design.figures if isinstance(each, Curves)):
        chart, axis = _chart(design, panel), _AXES[panel.x]
        same = next((each for each in charts if {**each, "axes": []} == chart), None)  # over another axis
        if same is None:
            charts.append({**chart, "axes": [axis]})
        elif axis not in same["axes"]:
            same["axes"].append(axis)
    return {
        "title": study_title(name),
        "groups": dict(design.groups),
        "variants": variants,
        "charts": charts,
        "speedups": [_speedup(study, each) for each in design.figures if isinstance(each, Speedup)],
    }


def _chart(design: StudyDesign, panel: CurvePanel) -> DesignedChart:
    """Return the chart of a panel, without its axis."""
    measure = panel.measure or design.curves[panel.env]
    return {
        "env": panel.env,
        "title": panel.title,
        "column": measure.column,
        "words": measure.words,
        "axes": [],
        "curves": [
            {
                "group": curve.group,
                "variant": curve.variant,
                "words": curve.words or design.label(curve.variant),
                "is_after_primitive": curve.is_after_primitive,
            }
            for curve in panel.curves
        ],
        "references": [{"words": each.words, "value": each.value} for each in panel.references],
        "has_running_best": panel.has_running_best,
    }


def _speedup(study: Study, asked: Speedup) -> DesignedSpeedup:
    """Return the chart of speed-ups: the paper's slope and the authors' times beside the curves."""
    cells = [cell for cell in study.cells if cell.group == asked.group]
    curves: list[DesignedCurve] = []
    cores, speedups = paper_line()
    series: list[Series] = [
        {
            "words": "paper, Figure 6 (slope)",
            "cores": cores.tolist(),
            "speedup": [round(value, 3) for value in speedups.tolist()],
            "color": -1,
            "is_line": True,
        }
    ]
    for number, variant in enumerate(dict.fromkeys(cell.variant for cell in cells)):
        words = study.design.label(variant)
        curves.append({"group": asked.group, "variant": variant, "words": words, "is_after_primitive": False})
        measured = authors_speedup(study.design.authors(variant))
        if measured is not None:
            words, at, faster = measured
            series.append({"words": words, "cores": at, "speedup": faster, "color": number, "is_line": False})
    env = cells[0].env if cells else ""
    return {
        "env": env,
        "title": env.replace("-", " ").title(),
        "curves": curves,
        "series": series,
        "kinds": dict(KINDS),
    }
