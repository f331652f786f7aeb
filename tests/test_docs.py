"""README and documentation agree with the code, have no broken links, need no network, and build without warnings."""

import contextlib
import importlib
import io
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.cli.program import COMMANDS
from shes.envs.named_environments import ENVIRONMENTS, Environment, find_environment
from shes.runs.config import known_settings
from shes.settings import flag
from tests.browser import find_browser, layout_faults
from tests.envs.episodes import make_task

pytestmark = pytest.mark.timeout(400)  # the first test that needs the site waits for its build

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
each_page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(DOCS).as_posix())
README = (ROOT / "README.md").read_text(encoding="utf-8")


def resources(text):
    """Return what a built page loads."""
    inline = re.findall(r"url\(([^)]*)\)", " ".join(re.findall(r'\sstyle="([^"]*)"', text)))
    links = re.findall(r'<link\b[^>]*?\shref="([^"]*)"', text)
    return [*re.findall(r'\s(?:src|srcset|data|poster)="([^"]+)"', text), *links, *inline]


def tables(text):
    """Return the text of every cell [table, row, column] of a built page."""
    found = re.findall(r"<table.*?</table>", text, re.DOTALL)
    parts = (re.findall(r"<tr.*?</tr>", table, re.DOTALL) for table in found)
    cells = ([re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in rows] for rows in parts)
    return [[[unescape(re.sub(r"<[^>]*>", "", cell)) for cell in row] for row in rows] for rows in cells]


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Return the folder of the site, built with --strict."""
    for package in ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers"):
        pytest.importorskip(package, reason="pip install 'shes[docs]'")
    folder = tmp_path_factory.mktemp("docs") / "site"
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    assert "WARNING" not in built.stdout + built.stderr
    return folder


@pytest.fixture(scope="session")
def pages(site):
    """Return the text of every built page by its path in the site."""
    return {path.relative_to(site).as_posix(): path.read_text("utf-8") for path in sorted(site.rglob("*.html"))}


@pytest.mark.extras
def test_every_page_is_built_and_no_python_file_is_copied(site, pages):
    expected = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in PAGES}
    expected |= {f"environments/{name}.html" for name in ENVIRONMENTS}
    assert expected <= set(pages)
    assert all(f'id="{name}"' in pages["reference/command-line.html"] for name in COMMANDS)
    (table,) = tables(pages["reference/shes.html"])
    assert [row[0] for row in table[1:]] == [f"shes.{name}" for name in shes.__all__]
    assert not list(site.rglob("*.py*"))


@pytest.mark.extras
def test_nothing_is_loaded_from_another_host(site, pages):
    loaded = [(name, link) for name, text in pages.items() for link in resources(text)]
    for path in site.rglob("*.css"):
        links = re.findall(r"(?:url\(|@import )[\"']?([^\"')]+)", path.read_text("utf-8"))
        loaded += [(path.name, link) for link in links]
    assert loaded
    assert not [(name, link) for name, link in loaded if re.match(r"([a-z]+:)?//", link)]


@pytest.mark.extras
@pytest.mark.timeout(1000)  # a browser opens every page
def test_pages_fit_a_window_and_a_telephone(site, pages, tmp_path):
    browser = find_browser()
    if browser is None:
        pytest.skip("there is no Chromium here")
    names = [name for name in pages if name != "404.html"]
    assert layout_faults(browser, site, names, [1280, 400], tmp_path) == []


@pytest.mark.extras
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_environments_page_lists_its_observations_and_actions(site, pages, name):
    task = make_task(name, 1)
    shown = [[row[1] for row in rows] for _, *rows in tables(pages[f"environments/{name}.html"])]
    for spec in task.specs:
        assert [each.name for each in make_task(name, 1, spec=spec).observation_spec] in shown
    assert list(task.body.controls) in shown
    assert (site / "environments" / f"{name}.png").stat().st_size > 1000
    assert f'href="{name}.html"' in pages["environments/index.html"]


def code_blocks(path, language):
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


@pytest.mark.extras
@pytest.mark.parametrize("page", ["environments/index.md", "extending.md", "external.md", "getting-started.md"])
def test_the_examples_of_a_page_run(page, tmp_path):
    blocks = code_blocks(DOCS / page, "python")
    assert blocks
    if page == "getting-started.md":  # its examples take this run
        shes.train("point-gather", preset="smoke", out=tmp_path / "runs" / "first", num_workers=1)
    for number, block in enumerate(blocks):
        script = tmp_path / f"example_{number}.py"
        script.write_text(block, encoding="utf-8")
        command = [sys.executable, "-W", "error", script]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("task", ["gather", "maze", "fall"])
def test_the_body_of_a_page_stands_on_every_ground(task):
    (block,) = (each for each in code_blocks(DOCS / "extending.md", "python") if "class Car(Body)" in each)
    names = {"__name__": "example"}
    exec(block, names)  # noqa: S102 - the page is of this repository
    body, kind = names["Car"], find_environment(f"point-{task}").task
    Environment(body, kind).make(1).reset(np.array([0]), [0])
    torso = kind.build_world(body(), kind.Options()).compile().body("torso")
    assert torso.pos[2] == kind.ground_m + 0.5


@pytest.fixture(scope="session")
def flags():
    """Return every flag in the help of `shes` and its commands, and of every setting."""
    commands = [["--help"], *([name, "--help"] for name in COMMANDS), ["train", "ant-gather", "--help-all"]]
    with contextlib.redirect_stdout(io.StringIO()) as text:
        assert [main(words) for words in commands] == [0] * len(commands)
    # That the help of `train` shows every setting of a run is tested with the command line.
    shown = re.findall(r"(?<![\w-])--[a-z][a-z-]+", text.getvalue())
    return {each.flag for each in known_settings().values()} | set(shown)


@pytest.mark.parametrize("path", [*PAGES, ROOT / "README.md"], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_flags_and_commands_exist(path, flags):
    text = path.read_text(encoding="utf-8")
    own = {"--mjcf", "--goal"}  # of the viewer of MuJoCo, and of an example
    own |= {"--logdir", "--head", "--address", "--oversubscribe"}  # of TensorBoard, Ray and MPI
    own |= {"--scale", "--seeds", "--only", "--no-run", "--description", "--command"}  # of `python -m experiments`
    own |= {flag(name) for name in re.findall(r"^ +(\w+): Annotated\[", text, flags=re.MULTILINE)}  # of an example
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= flags | own
    commands = re.findall(r"(?:^|`)(?:PYTHONPATH=\. )?shes ([a-z]+)", text, flags=re.MULTILINE)
    assert set(commands) <= set(COMMANDS)


@each_page
def test_code_and_tables_that_a_page_links_to_exist(path):
    text = path.read_text(encoding="utf-8")
    for name in re.findall(r"\]\[(shes[\w.]*)\]", text):
        pkgutil.resolve_name(name)
    tables = re.findall(r"\]\(([\w/.-]+\.(?:csv|json))\)", text)
    assert not [link for link in tables if not (path.parent / link).is_file()]
    assert tables or path != DOCS / "paper.md"


def test_the_readme_is_short_and_names_every_guide():
    guides = {path.relative_to(DOCS).as_posix() for path in PAGES if path.parent.name != "reference"}
    named = set(re.findall(r"\]\(docs/([\w/-]+\.md)\)", README))
    assert guides - {"index.md", "changelog.md", "results.md"} <= named
    assert len(README.split()) <= 550


def test_getting_started_names_every_example():
    examples = re.findall(r"^\| `(\w+\.py)` \|", (DOCS / "getting-started.md").read_text("utf-8"), re.MULTILINE)
    assert set(examples) == {path.name for path in (ROOT / "examples").glob("*.py")}


@pytest.mark.parametrize(("tables", "page"), [("experiment_tables", "experiments.md"), ("gpu_tables", "how-to/gpu.md")])
def test_the_tables_of_a_page_are_those_of_the_results(monkeypatch, tables, page):
    monkeypatch.syspath_prepend(DOCS)
    text = (DOCS / page).read_text(encoding="utf-8")
    assert importlib.import_module(tables).filled(text) == text, f"run: python docs/{tables}.py"


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\((?!http)([^)]+)\)", README))))
def test_a_link_of_the_readme_leads_to_a_file_or_to_its_line(link):
    path, _, anchor = link.partition("#L")
    assert (ROOT / path).exists()
    if anchor:
        assert "line" in (ROOT / path).read_text(encoding="utf-8").splitlines()[int(anchor) - 1]


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    (example,) = code_blocks(ROOT / "README.md", "python")
    for text, tiny in {"seed=0)": 'seed=0, generations=2, backend="serial")', "s=20)": "s=2, num_workers=1)"}.items():
        assert text in example
        example = example.replace(text, tiny, 1)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102 - our own README
    assert capsys.readouterr().out.splitlines()[-1] == "[1. 2. 3.]"


def test_a_run_is_shared_as_its_page_says(tiny_run, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(ROOT / "tests" / "stand_ins")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(tiny_run, "runs/first")
    assert main(["info", "runs/first", "--card"]) == 0
    card = capsys.readouterr().out
    Path("runs/first/README.md").write_text(card, encoding="utf-8")
    (example,) = code_blocks(DOCS / "how-to" / "share.md", "python")
    tiny = example.replace("episodes=20", "episodes=2, num_workers=1")
    exec(compile(tiny, "share.md", "exec"), {})  # noqa: S102 - our own page
    assert float(capsys.readouterr().out) > -9
    assert Path("runs/theirs/README.md").read_text(encoding="utf-8") == card


# Letters of shapes in docstrings and comments, primes included, are in the legend of docs/reference/index.md.

SHAPE = re.compile(r"(?<!\w)\[([\w'.]+(?:, [\w'. +*]+)*)\]")


LETTER = r"[A-Zn]'?"
PRIMED = re.compile(r"(?<![\w'])[A-Zn]'(?!\w)")


def letters(text):
    """Return the letters of shapes such as `[N, M' * E]`, and all letters with a prime."""
    axes = [axis for shape in SHAPE.findall(text) for axis in shape.split(", ")]
    products = [axis for axis in axes if re.fullmatch(rf"{LETTER}( [*+] {LETTER})*", axis)]
    return {*re.findall(LETTER, " ".join(products)), *PRIMED.findall(text)}


def prose(source):
    """Return docstrings and comments of a module, without its code."""
    parts = re.findall(r'"""(.*?)"""|#([^\n]*)', source, re.DOTALL)
    return "\n".join(docstring or comment for docstring, comment in parts)


def test_every_letter_of_a_shape_is_in_the_legend():
    text = (ROOT / "docs/reference/index.md").read_text("utf-8")
    rows = re.findall(rf"^\| ({LETTER}(?:, [A-Z])*) \| ", text, re.MULTILINE)
    legend = {letter for row in rows for letter in row.split(", ")}
    used = {
        letter: str(path.relative_to(ROOT))
        for path in sorted((ROOT / "src/shes").rglob("*.py"))
        for letter in letters(prose(path.read_text("utf-8")))
    }
    assert {letter: where for letter, where in used.items() if letter not in legend} == {}
    assert legend - used.keys() == set()
