"""`python -m experiments`: small experiments to their end, stopped anywhere and gone on with; wrong words."""

import csv
import os
import re
import signal
import sys
from functools import partial
from pathlib import Path

import psutil
import pytest

from experiments.__main__ import EXPERIMENTS, main
from tests.e2e import runs

ROOT = Path(__file__).parents[2]
SOME = ("ablation", "--scale", "smoke", "--only", "without", "transfer", "--workers", "2")
TIMES = ("seconds", "primitive_seconds", "hours", "primitive_hours")


start = partial(runs.start, command=(sys.executable, "-m", "experiments"), cwd=ROOT)


def run(*words):
    """Run `python -m experiments WORDS`, which must succeed; return what it printed."""
    process = start(*words)
    out, err = process.communicate()
    assert (process.returncode, err) == (0, ""), out
    return out


def table(path, *, has_times=False):
    """Return the rows of a table, without what depends on time if not asked for."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return rows if has_times else [{name: row[name] for name in row if name not in TIMES} for row in rows]


WRONG = {
    "ablation --scale smoke --only choice": r"unknown group or environment 'choice'\. Did you mean 'choices'",
    "ablation --scale paper": r"unknown scale 'paper'\. Known: laptop, smoke\. Set --scale\.",
    "fig4 --scale laptop --seeds 0": r"seeds must be a whole number between 1 and 1000, got 0\. Set --seeds\.",
    "fig3 --scale smoke --backend ray": "--backend ray is for runs that have all workers: scale paper and fig4",
    "fig3 --scale smoke --no-run": r"out has no row of fig3 in runs\.csv\. Set --out, or omit --no-run",
    "ablation --scale smoke --only without --workers -1": r"workers must be a whole number of at least 0, got -1\. Set",
    "fig6 --no-run": r"out has no fig6\.csv with a measurement\. Omit --no-run",
}


@pytest.mark.parametrize("line", WRONG)
def test_words_that_make_no_sense_are_refused(line, tmp_path, capsys):
    assert main([*line.split(), "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.search(WRONG[line], " ".join(err.split()))
    assert not (tmp_path / "out").exists()


def test_what_is_there_is_compared_and_drawn_without_a_run(tmp_path, capsys):
    """Of one group: the comparisons of the others take their time."""
    kept, group = ROOT / "results" / "ablation", "without"
    for name in ("runs.csv", "curves.csv"):
        header, *lines = (kept / name).read_text().splitlines(keepends=True)
        lines = [line for line in lines if line.startswith((f"{group},", "choices,base,"))]
        (tmp_path / name).write_text("".join([header, *lines]))
    before = (tmp_path / "runs.csv").read_bytes()
    assert main(["ablation", "--out", str(tmp_path), "--no-run"]) == 0
    assert (tmp_path / "runs.csv").read_bytes() == before
    rows = [row for row in table(tmp_path / "comparison.csv") if row["group"] == group]
    expected = [row for row in table(kept / "comparison.csv") if row["group"] == group]
    for name in ("score_mean", "score_iqm_low", "p_holm"):
        assert [float(row[name] or -1) for row in rows] == pytest.approx([float(row[name] or -1) for row in expected])
    assert {path.name for path in tmp_path.glob("*.png")} == {"without.png"}
    assert "no search" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.extras
@pytest.mark.timeout(600)
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_experiment_goes_on_with_the_same_numbers(tmp_path, stop):
    undisturbed, out = tmp_path / "undisturbed", tmp_path / "ablation"
    run(*SOME, "--out", undisturbed)
    process = start(*SOME, "--out", out)
    runs.wait_until(lambda: len(list(out.glob("*/*/*/*/summary.json"))) >= 4 or process.poll() is not None, "4 runs")
    workers = psutil.Process(process.pid).children()
    assert process.poll() is None
    os.kill(process.pid, stop)
    printed, err = process.communicate()
    assert process.returncode == (130 if stop == signal.SIGINT else -stop)
    if stop == signal.SIGINT:
        assert printed.endswith("Stopped; finished runs are kept. Continue with the same command.\n"), err
    assert len(workers) >= 2
    assert psutil.wait_procs(workers, timeout=runs.PATIENCE_S)[1] == []
    run(*SOME, "--out", out)
    for name in ("runs.csv", "curves.csv", "comparison.csv"):
        assert table(out / name) == table(undisturbed / name)
    for row in table(out / "runs.csv"):
        path = f"{row['env']}/{row['group']}/{row['variant']}/seed-{row['seed']}"
        different = [name for name in runs.differences(out / path, undisturbed / path) if "settings" not in name]
        assert different == []  # settings hold the path of the primitive


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ablation", "walker")),
        *(pytest.param(name, marks=pytest.mark.extras) for name in ("fig4", "fig5")),
        pytest.param("fig3", marks=pytest.mark.hiro),
    ],
)
def test_an_experiment_of_scale_smoke_has_tables_and_figures(name, tmp_path):
    experiment, out, copy = EXPERIMENTS[name]("smoke", None), tmp_path / "whole", tmp_path / "copy"
    copy.mkdir()
    printed = run(name, "--scale", "smoke", "--workers", 2, "--out", out)
    assert {path.name for path in out.glob("*.png")} >= set(experiment.figures)
    assert all(figure in printed for figure in experiment.figures)
    compared = table(out / (f"{name}.csv" if name.startswith("fig") else "comparison.csv"), has_times=True)
    variants = {each.variant for each in experiment.runs if each.env in experiment.metrics}
    assert {row["variant"] for row in compared} == variants
    for row in compared:
        is_tested = row["against"] and row["seeds"] != "1"  # at this scale the ant has one seed
        filled = ["score_mean", "score_iqm_low", "score_iqm_high", "hours"]
        filled += ["p_holm", "mann_whitney_p", "superiority"] if is_tested else []
        filled += ["ratio", "ratio_low"] if name == "fig4" and row["against"] else []
        assert all(row[column] for column in filled), row
    for file in out.glob("*.csv"):
        (copy / file.name).write_bytes(file.read_bytes())
    again = run(name, "--scale", "smoke", "--workers", 2, "--out", copy)
    assert f"0 of {len(experiment.runs)} runs are left" in again
    assert not any(path.is_dir() for path in copy.iterdir())
    for figure in experiment.figures:
        assert (copy / figure).read_bytes() == (out / figure).read_bytes()
