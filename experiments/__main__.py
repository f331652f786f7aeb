"""The command line: `python -m experiments NAME --scale laptop`, and `python -m experiments ship RUN NAME ...`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path

from rich.table import Table

from experiments import figure6, ship
from experiments.ablation import ablation
from experiments.comparisons import compare
from experiments.design import Experiment
from experiments.figures import draw_figures
from experiments.paper import figure_3, figure_4, figure_5
from experiments.results import PlacedResults, read_results, read_tables, write_csv
from experiments.running import run_experiment
from experiments.walker import walker
from shes.console import LineConsole
from shes.errors import ConfigError, ShesError
from shes.runs.tables import Row

EXPERIMENTS: dict[str, Callable[[str, int | None], Experiment]] = {
    "table1": figure_3,
    "fig3": figure_3,
    "fig4": figure_4,
    "fig5": figure_5,
    "ablation": ablation,
    "walker": walker,
}
"""Functions of the scale and the number of seeds. Figure 6 has measurements instead of runs."""
_OF_THE_PAPER = ("table1", "fig3", "fig4", "fig5", "fig6")
_CONSOLE = LineConsole()


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Return what a command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments",
        description="Run an experiment of many runs and draw its figures. The same command continues one that was "
        "stopped. `python -m experiments ship --help`: make a shipped agent of a run.",
    )
    scale = "smoke: minutes; laptop: hours on two cores (default); paper: Table I, on a cluster"
    workers = "runs at a time, or workers of each large run; 0 is one for every core (default)"
    parser.add_argument("name", choices=[*EXPERIMENTS, "fig6"], help="the experiment")
    parser.add_argument("--scale", choices=["smoke", "laptop", "paper"], default="laptop", help=scale)
    parser.add_argument("--out", type=Path, help="folder of runs, tables and figures (default: below runs)")
    parser.add_argument("--seeds", type=int, help="seeds per variant (default: those of the scale)")
    parser.add_argument("--only", nargs="+", default=(), metavar="PART", help="groups or environments to run")
    parser.add_argument("--workers", type=int, default=0, dest="num_workers", metavar="N", help=workers)
    parser.add_argument("--backend", default="processes", help="backend of large runs: scale paper and fig4")
    parser.add_argument("--no-run", action="store_false", dest="run", help="draw what runs.csv and curves.csv have")
    return parser.parse_args(words)


def main(words: Sequence[str]) -> int:
    """Run a command line; return the exit code."""
    try:
        if words[:1] == ["ship"]:
            return ship.main(words[1:])
        asked = parse(words)
        out = asked.out or Path("runs") / ("paper" if asked.name in _OF_THE_PAPER else asked.name)
        if asked.out is None and asked.scale != "laptop":
            out = out.with_name(f"{out.name}-{asked.scale}")
        if asked.name != "fig6":
            return _experiment(asked, out)
        if asked.run:
            figure6.measure(asked.scale, out, asked.num_workers)
        _CONSOLE.print_line(f"Figure: {figure6.draw(out)}")
    except ShesError as error:
        LineConsole(stderr=True).print_error(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        _CONSOLE.print_line("Stopped; finished runs are kept. Continue with the same command.")
        return 130
    return 0


def _experiment(asked: argparse.Namespace, out: Path) -> int:
    experiment = EXPERIMENTS[asked.name](asked.scale, asked.seeds)
    if asked.backend != "processes" and not experiment.has_large_runs:
        raise ConfigError(
            f"--backend {asked.backend} is for runs that have all workers: scale paper and fig4. Omit it."
        )
    failed: dict[str, str] = {}
    if asked.run:
        workers = {"num_workers": asked.num_workers, "backend": asked.backend}
        failed = run_experiment(experiment.only(asked.only), out, say=_CONSOLE.print_line, **workers)
        results = read_results(experiment, out)
    else:
        results = read_tables(experiment, out, has_any_settings=True)
        if not results:
            raise ConfigError(f"{out} has no row of {asked.name} in runs.csv. Set --out, or omit --no-run.")
    _write(asked.name, experiment, PlacedResults(experiment, results), out)
    for name, error in failed.items():
        LineConsole(stderr=True).print_error(f"{name} failed: {error}")
    return 1 if failed else 0


def _write(name: str, experiment: Experiment, results: PlacedResults, out: Path) -> None:
    """Write comparisons and figures of finished runs into `out`, and print the comparisons."""
    results.comparisons = compare(results)
    if results.comparisons:
        write_csv(out / (f"{name}.csv" if name in _OF_THE_PAPER else "comparison.csv"), results.comparisons)
    figures = draw_figures(results, out)
    for env, rows in groupby(results.comparisons, lambda row: row["env"]):
        _CONSOLE.print(_comparison_table(experiment, env, list(rows)))
    _CONSOLE.print_line(f"Figures: {' '.join(map(str, figures)) or 'none'}")


def _comparison_table(experiment: Experiment, env: str, rows: Sequence[Row]) -> Table:
    """Return the comparisons in an environment as a table: with the ratio where times are compared."""
    last = "ratio [of seeds]" if experiment.has_ratios else "p (Holm)"
    title = f"{env}: {experiment.metrics[env].words}"
    table = Table("group", "variant", "compared with", "seeds", "mean [95 %]", last, title=title)
    for row in rows:
        other = "" if row["against"] is None else f"{row['against_group']}: {experiment.label(row['against'])}"
        interval = f" [{row['score_low']:.2f}, {row['score_high']:.2f}]" if row["seeds"] > 1 else ""
        values = (row["ratio"], row["ratio_low"], row["ratio_high"]) if experiment.has_ratios else (row["p_holm"],)
        text = "" if None in values else " ".join(f"{value:.4g}" for value in values)
        mean = f"{row['score_mean']:.2f}{interval}"
        table.add_row(row["group"], experiment.label(row["variant"]), other, str(row["seeds"]), mean, text)
    return table


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
