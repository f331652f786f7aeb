"""MkDocs hooks: add the pages and tables that are made from the code, and the files of the repository that pages show.

A page that is named in `_GENERATED` holds `<!-- generated -->` on a line of its own, which its table replaces. A link
to a CSV or JSON file outside `docs` or to a picture of `results`, such as `../results/speed.csv`, leads to a copy of
the file in the site.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

from code_tables import commands, deviations, hyperparameters, public_names, settings
from environment_pages import environment_page, environment_table, picture
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from shes.envs.named_environments import ENVIRONMENTS

_REPOSITORY = Path(__file__).parents[1]
_RESULTS = _REPOSITORY / "results"
_GENERATED = {
    "differences.md": deviations,
    "environments/index.md": environment_table,
    "paper.md": hyperparameters,
    "reference/command-line.md": commands,
    "reference/settings.md": settings,
    "reference/shes.md": public_names,
}

_SHOWN = {"results.md": '--8<-- "results/README.md"'}
"""Pages of the site that show a file of the repository; without the site they name it."""
_COPIES = "repository"
"""Folder of the site with copies of linked files."""
_FILE = re.compile(r"\]\((?P<up>(?:\.\./)*)\.\./(?P<path>[\w/.-]+\.(?:csv|json)|results/[\w/.-]+\.png)\)")

_CELL = re.compile(r"<t[dh]\b.*?</t[dh]>", flags=re.DOTALL)
_CODE = re.compile(r"(?<=<code>)[^<]+(?=</code>)")


def on_config(config: MkDocsConfig) -> None:
    """Add the page of every environment to the navigation, after the page of all."""
    (reference,) = [entry["Reference"] for entry in config.nav or [] if "Reference" in entry]
    (environments,) = [entry["Environments"] for entry in reference if "Environments" in entry]
    environments += [f"environments/{name}.md" for name in ENVIRONMENTS]


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add a page and a picture of every environment, and the pictures of `results/README.md`."""
    add = partial(File.generated, config)
    for name in ENVIRONMENTS:
        files.append(add(f"environments/{name}.md", content=environment_page(name)))
        files.append(add(f"environments/{name}.png", content=picture(name)))
    for path in _RESULTS.rglob("*.png"):  # relative to results.md as to results/README.md, which it includes
        files.append(add(path.relative_to(_RESULTS).as_posix(), abs_src_path=str(path)))
    linked = {found["path"] for page in files.documentation_pages() for found in _FILE.finditer(page.content_string)}
    for path in sorted(linked):
        files.append(add(f"{_COPIES}/{path}", abs_src_path=str(_REPOSITORY / path)))


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Put its generated table into a page, and lead its links to files of the repository to their copies."""
    uri = page.file.src_uri
    if uri in _SHOWN:
        return _SHOWN[uri]
    markdown = _FILE.sub(rf"](\g<up>{_COPIES}/\g<path>)", markdown)
    return markdown.replace("<!-- generated -->", _GENERATED[uri]()) if uri in _GENERATED else markdown


def on_page_content(html: str, **_: Any) -> str:
    """Mark the words of code in tables, which are not broken: a browser would break a flag after its hyphens."""
    return _CELL.sub(lambda cell: _CODE.sub(_marked_words, cell[0]), html)


def _marked_words(code: re.Match[str]) -> str:
    return re.sub(r"\S+", r'<span class="word">\g<0></span>', code[0])
