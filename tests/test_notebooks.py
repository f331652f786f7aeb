"""The notebooks are stored without output, and run from top to bottom."""

import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples" / "notebooks").glob("*.ipynb"))
HEXAPOD = NOTEBOOKS[0].parents[1] / "hexapod.xml"
SHORTER = {"GENERATIONS": "2", "GENERATIONS, SEEDS": "2, (1, 2)", "STEPS": "4", "ROBOT": repr(str(HEXAPOD))}
"""Values that a test sets instead of those of a notebook."""
SHOWS = {
    "walk": ["text/html", "image/png", "text/html"],
    "change_one_thing": ["text/html", "image/png"],
    "my_robot": ["image/png", "text/html"],
}
"""Progress, figures and video that each displays, in order; repetitions left out."""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_output(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert {(cell["execution_count"], *cell["outputs"]) for cell in cells if cell["cell_type"] == "code"} == {(None,)}


@pytest.mark.extras
@pytest.mark.render
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_progress_and_pictures(path, tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        for name, value in SHORTER.items():
            cell.source = re.sub(rf"^{name} = .*$", f"{name} = {value}", cell.source, flags=re.MULTILINE)
    nbclient.NotebookClient(notebook, timeout=110, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [kind for output in outputs for kind in output.get("data", ()) if kind in {"text/html", "image/png"}]
    assert [kind for kind, before in zip(kinds, [None, *kinds], strict=False) if kind != before] == SHOWS[path.stem]
