"""The tables of the page of experiments are those of the stored results."""

from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def test_the_tables_are_up_to_date(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import experiment_tables

    page = (DOCS / "experiments.md").read_text(encoding="utf-8")
    assert experiment_tables.filled(page) == page, "run: python docs/experiment_tables.py"
