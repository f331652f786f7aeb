"""The documentation builds without warnings, agrees with the code, has no broken links, and needs no network."""

import contextlib
import importlib
import importlib.util
import io
import os
import pkgutil
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.cli.program import COMMANDS
from shes.envs.gymnasium_ids import gymnasium_id
from shes.envs.named_environments import ENVIRONMENTS, Environment, find_environment, make_task
from shes.envs.tasks.task_options import TaskOptions
from shes.runs.config import known_settings
from shes.settings import flag, setting_fields
from tests.browser import find_browser, layout_faults

pytestmark = pytest.mark.timeout(400)  # the first test that needs the site waits for its build

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SRC = ROOT / "src" / "shes"
PAGES = sorted(DOCS.rglob("*.md"))


class Page(HTMLParser):
    """Ids, links, resources and tables of a built page."""

    def __init__(self, path):
        super().__init__()
        self.path = path
        self.ids = set()
        self.links = []
        self.resources = []
        self.tables = []
        self._cell = None
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids |= {values[key] for key in ("id", "name") if values.get(key)}
        if tag in ("a", "area"):
            self.links.append(values.get("href") or "")
        elif tag == "link":
            self.resources.append(values["href"])
        self.resources += [values[key] for key in ("src", "srcset", "data", "poster") if values.get(key)]
        self.resources += re.findall(r"url\(([^)]*)\)", values.get("style") or "")
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._cell = {"text": "", "links": []}
            self.tables[-1][-1].append(self._cell)
        elif tag == "a" and self._cell is not None:
            self._cell["links"].append(values.get("href"))

    def handle_data(self, data):
        if self._cell is not None:
            self._cell["text"] += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cell = None


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Return the folder of the site, built with --strict."""
    for package in ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"the documentation needs {package}: pip install 'shes[docs]'")
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
    """Return every built page by its path in the site."""
    return {path.relative_to(site).as_posix(): Page(path) for path in sorted(site.rglob("*.html"))}


@pytest.mark.extras
def test_every_page_is_built_and_no_python_file_is_copied(site, pages):
    expected = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in PAGES}
    expected |= {f"environments/{name}.html" for name in ENVIRONMENTS}
    assert expected <= set(pages)
    assert set(COMMANDS) <= pages["reference/command-line.html"].ids
    (table,) = pages["reference/shes.html"].tables
    assert [row[0]["text"] for row in table[1:]] == [f"shes.{name}" for name in shes.__all__]
    assert not list(site.rglob("*.py*"))


@pytest.mark.extras
def test_every_link_leads_to_a_file_and_to_an_anchor_in_it(site, pages):
    broken = []
    for name, page in pages.items():
        if name == "404.html":  # its links are absolute, because it is served for any address
            continue
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme in ("http", "https", "mailto"):
                continue
            assert not parts.scheme, f"{name}: {link}"
            target = (site / name).parent / unquote(parts.path) if parts.path else site / name
            other = pages.get(os.path.relpath(target, site))
            anchor = unquote(parts.fragment)
            if not target.is_file() or (anchor and (other is None or anchor not in other.ids)):
                broken.append(f"{name}: {link}")
    assert not broken


@pytest.mark.extras
def test_nothing_is_loaded_from_another_host(site, pages):
    loaded = [(name, resource) for name, page in pages.items() for resource in page.resources]
    for path in site.rglob("*.css"):
        text = path.read_text(encoding="utf-8")
        loaded += [(path.name, resource) for resource in re.findall(r"(?:url\(|@import )[\"']?([^\"')]+)", text)]
    assert loaded
    assert not [(name, link) for name, link in loaded if re.match(r"([a-z]+:)?//", link)]


@pytest.mark.extras
@pytest.mark.timeout(1000)  # a browser opens every page
def test_at_the_width_of_a_window_and_of_a_telephone_nothing_is_cut_or_broken(site, pages, tmp_path):
    browser = find_browser()
    if browser is None:
        pytest.skip("there is no Chromium here")
    names = [name for name in pages if name != "404.html"]
    assert layout_faults(browser, site, names, [1280, 400], tmp_path) == []


@pytest.mark.extras
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_environments_page_lists_its_observations_and_actions(site, pages, name):
    task = make_task(name, 1)
    page = pages[f"environments/{name}.html"]
    tables = {tuple(cell["text"] for cell in table[0][:2]): table[1:] for table in page.tables}
    observed = [table[1:] for table in page.tables if table[0][1]["text"] == "name"]
    for spec, rows in zip(task.specs, observed, strict=True):
        elements = make_task(name, 1, TaskOptions(spec=spec)).observation_spec
        assert [row[1]["text"] for row in rows] == [element.name for element in elements]
        assert [row[0]["text"] for row in rows] == [str(i) for i in range(len(elements))]
    assert [row[1]["text"] for row in tables["index", "control"]] == list(task.body.controls)
    facts = {row[0]["text"]: row[1]["text"] for row in tables["Gymnasium id", gymnasium_id(name)]}
    assert facts["Score"] == type(task).description.score
    assert {row[0]["text"] for row in tables["argument", "default"]} == setting_fields(task.Options).keys()
    assert (site / "environments" / f"{name}.png").stat().st_size > 1000
    assert f"{name}.html" in pages["environments/index.html"].links


def code_blocks(path, language):
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


@pytest.mark.extras
@pytest.mark.parametrize(
    ("page", "number"),
    [
        (page, number)
        for page in ("environments/index.md", "extending.md", "external.md")
        for number in range(len(code_blocks(DOCS / page, "python")))
    ],
)
def test_an_example_of_a_page_runs(page, number, tmp_path):
    script = tmp_path / "example.py"
    script.write_text(code_blocks(DOCS / page, "python")[number], encoding="utf-8")
    run(script)


@pytest.mark.parametrize("task", ["gather", "maze", "fall"])
def test_the_body_of_a_page_stands_on_the_ground_of_every_kind_of_task(task):
    (block,) = (each for each in code_blocks(DOCS / "extending.md", "python") if "class Car(Body)" in each)
    names = {"__name__": "example"}
    exec(block, names)  # noqa: S102 - the page is of this repository
    body, kind = names["Car"], find_environment(f"point-{task}").task
    Environment(body, kind).make(1).reset(np.array([0]), [0])
    torso = kind.build_world(body(), kind.Options()).compile().body("torso")
    assert torso.pos[2] == kind.ground_m + 0.5


@pytest.mark.extras
def test_the_python_of_getting_started_runs(tmp_path):
    blocks = code_blocks(DOCS / "getting-started.md", "python")
    assert len(blocks) >= 3
    shes.train("point-gather", preset="smoke", out=tmp_path / "runs" / "first", num_workers=1)
    for number, block in enumerate(blocks):
        script = tmp_path / f"block_{number}.py"
        script.write_text(block, encoding="utf-8")
        assert run(script)


def run(script):
    """Run a script in its folder, with warnings as errors; return its output."""
    done = subprocess.run(
        [sys.executable, "-W", "error", script], cwd=script.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def flags():
    """Return every flag in the help of `shes` and its commands, and of every setting."""
    commands = [["--help"], *([name, "--help"] for name in COMMANDS), ["train", "ant-gather", "--help-all"]]
    with contextlib.redirect_stdout(io.StringIO()) as text:
        assert [main(words) for words in commands] == [0] * len(commands)
    # That the help of `train` shows every setting of a run is tested with the command line.
    return {each.flag for each in known_settings().values()} | set(
        re.findall(r"(?<![\w-])--[a-z][a-z-]+", text.getvalue())
    )


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_flags_and_commands_exist(path, flags):
    text = path.read_text(encoding="utf-8")
    own = {"--logdir", "--head", "--address", "--oversubscribe"}  # of TensorBoard, Ray and MPI
    own |= {"--scale", "--seeds", "--only", "--no-run", "--description", "--command"}  # of `python -m experiments`
    own |= {flag(name) for name in re.findall(r"^ +(\w+): Annotated\[", text, flags=re.MULTILINE)}  # of an example
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= flags | own
    commands = re.findall(r"(?:^|`)(?:PYTHONPATH=\. )?shes ([a-z]+)", text, flags=re.MULTILINE)
    assert set(commands) <= set(COMMANDS)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_code_that_a_page_links_to_exists(path):
    for name in re.findall(r"\]\[(shes[\w.]*)\]", path.read_text(encoding="utf-8")):
        pkgutil.resolve_name(name)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_tables_that_a_page_links_to_are_in_the_repository(path):
    links = re.findall(r"\]\(([\w/.-]+\.(?:csv|json))\)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (path.parent / link).is_file()]
    assert links or path != DOCS / "paper.md"


def test_the_readme_names_every_guide():
    guides = {path.relative_to(DOCS).as_posix() for path in PAGES if path.parent.name != "reference"}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\]\(docs/([\w/-]+\.md)\)", readme))
    assert guides - {"index.md", "changelog.md", "results.md"} <= named


def test_getting_started_names_every_example():
    text = (DOCS / "getting-started.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+\.py)` \|", text, flags=re.MULTILINE)) == {
        path.name for path in (ROOT / "examples").glob("*.py")
    }


@pytest.mark.parametrize(("tables", "page"), [("experiment_tables", "experiments.md"), ("gpu_tables", "how-to/gpu.md")])
def test_the_tables_of_a_page_are_those_of_the_results(monkeypatch, tables, page):
    monkeypatch.syspath_prepend(DOCS)
    text = (DOCS / page).read_text(encoding="utf-8")
    assert importlib.import_module(tables).filled(text) == text, f"run: python docs/{tables}.py"
