"""Every example is short, runs as it is, and prints the expected last line; notebooks are stored without output.

New examples and notebooks are found by their files.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import shes

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
MAX_LINES = {"random_search": 80, "run_exported": 155, "optuna_search": 25, "wandb_logging": 25}
"""Maximum number of lines of an example; 60 by default."""
PRINTS = {
    "animate_search": r"search\.gif: 809 places, a path of 300 steps",
    "drive_robot": r" 10 s: \d\.\d\d m to the goal",
    "es_on_sphere": r"generation 200: distance 0\.0\d+",
    "figure_from_csv": r"figure\.png: 470 generations of ant-gather-laptop",
    "flat_es": r"generation 30: return [1-9]\.\d+",
    "hierarchical_run": r"one episode of 500 steps: return [+-]\d+",
    "optuna_search": r"the best of 2 runs has sigma=0\.\d+",
    "own_environment": r"checkpoint last: score ([89]|\d\d)\.\d",
    "run_exported": r"ant-gather: 50 observed values become 8 controls",
    "random_search": r"Best\(generation=\d+, score=.*",
    "wandb_logging": r"logged 4 generations",
    "own_reward": r"after: primitive return [3-9]\d\.\d per episode",
}
"""Last line that each example prints, which shows that it works and learns."""
SMALL = {
    "generations": 1,
    "population_size": 4,
    "noise_table_size": 1_000_000,
    "horizon": 50,
    "evaluation_horizon": 50,
    "backend": "serial",
}
"""Settings of a run whose policy an example drives."""
STAND_INS = Path(__file__).parent / "stand_ins"
"""Modules for optional packages that examples need, whether they are installed or not."""
SECONDS = {"animate_search", "flat_es", "hierarchical_run", "optuna_search", "own_environment", "own_reward"}
SECONDS |= {"random_search", "wandb_logging"}
"""Examples that take more than about three seconds. Random search has the tests of every algorithm, too."""


def named(path):
    return pytest.param(path, id=path.stem, marks=[pytest.mark.extras] if path.stem in SECONDS else [])


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_what_it_prints_is_known(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_LINES.get(path.stem, 60)
    assert 'if __name__ == "__main__":' in text
    assert path.stem in PRINTS, "add the last line that it prints to PRINTS"


def say(folder, *words):
    """Run Python in a folder, with stand-ins for optional packages; return the last line that it prints."""
    environment = {**os.environ, "PYTHONPATH": str(STAND_INS)}
    done = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, cwd=folder, env=environment, timeout=110, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("path", [named(path) for path in EXAMPLES])
def test_an_example_runs(path, tmp_path):
    if path.stem == "run_exported":
        shes.export("ant-gather", tmp_path / "policy.npz")
    if path.stem == "drive_robot":
        run = shes.train("flagrun", robot=str(path.with_name("hexapod.xml")), out=tmp_path / "run", **SMALL)
        shes.export(run.path, tmp_path / "policy.npz")
    last = say(tmp_path, path)
    assert re.fullmatch(PRINTS[path.stem], last), last


@pytest.mark.extras
def test_trackio_takes_the_place_of_wandb(tmp_path):
    text = (EXAMPLES[0].parent / "wandb_logging.py").read_text(encoding="utf-8")
    (tmp_path / "logging_run.py").write_text(text.replace("import wandb", "import trackio as wandb"))
    assert say(tmp_path, "logging_run.py") == "logged 4 generations"


NOTEBOOKS = sorted((EXAMPLES[0].parent / "notebooks").glob("*.ipynb"))
HEXAPOD = EXAMPLES[0].with_name("hexapod.xml")
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
@pytest.mark.timeout(400)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_progress_and_pictures(path, tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        for name, value in SHORTER.items():
            cell.source = re.sub(rf"^{name} = .*$", f"{name} = {value}", cell.source, flags=re.MULTILINE)
    nbclient.NotebookClient(notebook, timeout=380, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [kind for output in outputs for kind in output.get("data", ()) if kind in {"text/html", "image/png"}]
    assert [kind for kind, before in zip(kinds, [None, *kinds], strict=False) if kind != before] == SHOWS[path.stem]
