"""Figure 6: what is measured once, is not measured again; what its picture shows."""

import csv
from pathlib import Path

import pytest

from experiments.figure6 import LABELS, PAPER_SECONDS, draw, measure, measured_runs, read_rows, speedup_figure

STORED = Path(__file__).parents[2] / "results" / "paper" / "fig6.csv"


def test_the_picture_has_every_kind_of_row_and_the_authors_times():
    rows = read_rows(STORED)
    [axis] = speedup_figure(rows).axes
    drawn = {line.get_label(): line for line in axis.lines}
    for words in LABELS.values():
        assert {f"{words}, projected", f"{words}, measured"} <= drawn.keys()
    projected = drawn["SHES as published, projected"]
    own = [row for row in rows if (row["variant"], row["kind"]) == ("published", "projected")]
    assert projected.get_ydata().tolist() == [float(row["speedup"]) for row in own]
    slope = dict(zip(*drawn["paper, Figure 6 (slope)"].get_data(), strict=True))
    assert (slope[1], slope[250], slope[600]) == (1, 50, 100)
    seconds = PAPER_SECONDS["es"]
    assert drawn["S-ES, authors' code"].get_ydata()[-1] == seconds[1] / seconds[240]


@pytest.mark.extras
@pytest.mark.timeout(600)
def test_a_measurement_is_kept_and_not_made_again(tmp_path):
    measure("smoke", tmp_path, 2)
    with (tmp_path / "fig6.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["variant"] for row in rows} == {run.variant for run in measured_runs("smoke")}
    for row in rows:
        assert float(row["speedup"]) > 0
        assert row["hardware"]
        assert row["versions"]
    before = (tmp_path / "fig6.csv").read_bytes()
    measure("smoke", tmp_path, 2)
    assert (tmp_path / "fig6.csv").read_bytes() == before
    assert draw(tmp_path).stat().st_size > 10_000
