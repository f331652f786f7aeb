"""The tables of docs/how-to/gpu.md are up to date."""

import sys
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def test_the_tables_are_those_of_the_results(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import gpu_tables

    page = (DOCS / "how-to" / "gpu.md").read_text(encoding="utf-8")
    assert gpu_tables.filled(page) == page
    for name in ("gpu_tables", "markdown_table"):
        del sys.modules[name]
