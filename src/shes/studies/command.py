"""`shes experiment`: a study or an experiment of the paper by its name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import Literal

from shes.listing import Listing, Table
from shes.studies import perform
from shes.studies.table1 import settings_beside
from shes.studies.tables import write_csv

_run: Callable[..., Listing] = perform.experiment
_OF_THE_PAPER = ("table1", "fig3", "fig4", "fig5", "fig6")


def experiment(
    name: Literal["ablation", "learning", "table1", "fig3", "fig4", "fig5", "fig6"],
    *,
    out: Path | None = None,
    num_workers: int = 0,
    backend: str = "processes",
    scale: Literal["paper", "laptop", "smoke"] = "laptop",
    seeds: int | None = None,
    only: Sequence[str] | None = None,
    budget: float | None = None,
) -> Listing:
    """Run a study of many runs and draw its figures. The same command continues a study that was stopped.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the paper's choices, a sweep of the settings, transfer and horizon, on Point Gather and Maze;
            learning: an ablation of the walker's training method, on Ant Flagrun; the others: Table I and the figures
            of the paper, with SHES as published and with the pieces of the learning study; table1 and fig3 also with
            HIRO, which needs the extra hiro.
        out: Folder of its runs, tables and figures; finished runs in it are kept. If none, below runs/ its name, and
            paper for the experiments of the paper, which share runs.
        num_workers: Runs at a time, or the workers of each run of scale paper; 0 is one for every core. fig4 has
            numbers of its own, fig6 measures all up to this one.
        backend: Backend of the runs of scale paper, such as ray.
        scale: paper: Table I, ten runs of up to ten hours, for experiments of the paper only; laptop: hours on two
            cores; smoke: minutes, as a test.
        seeds: Seeds of every variant; if none 10, of scale laptop 5 in a sweep, in learning and for the ant, and 3 in
            fig4 and fig6; of scale smoke 1 or 2.
        only: Groups or environments to run, groups beside the base; all if none. ablation: choices, horizon, sweep,
            transfer; learning: alternatives, form, pieces, sweep; table1: methods; fig3: methods; fig4: workers;
            fig5: methods, transfer; fig6: speedup.
        budget: Hours after which all runs stop; the same command continues them.

    Raises:
        ShesError: Raised by `choose` or `run_study`.
    """
    is_paper = name in _OF_THE_PAPER
    out = out or Path("runs") / ("paper" if is_paper else name)
    found = _run(
        name,
        out=out,
        num_workers=num_workers,
        backend=backend,
        scale=scale,
        seeds=seeds,
        only=only,
        budget=budget,
    )
    if not is_paper:
        return found
    # Other experiments in the folder write `comparison.csv`, too.
    write_csv(out / f"{name}.csv", found.facts["comparisons"])
    parts = [*found.parts, f"Table: {quote(str(out / f'{name}.csv'))}"]
    if name != "table1":
        return found._replace(parts=parts)
    rows = settings_beside()
    write_csv(out / "table1-settings.csv", rows)
    texts = [["-" if value is None else f"{value}" for value in row.values()] for row in rows]
    headings = ("Table I", "SHES, SHES-TL", "scale paper", "HIRO", "scale paper")
    return Listing({**found.facts, "settings": rows}, [Table(headings, texts), *parts], found.errors)
