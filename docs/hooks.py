"""What mkdocs calls while it builds: adds the generated pages, and fills the places that pages leave for the code.

A page may hold

- `<!-- generated: NAME ARGUMENTS -->` on a line of its own: the table or text of that generator;
- `[[shes.es.level.perturb]]`: a link to where that name is defined. A name that does not exist ends the build.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Any

from generate import algorithm, commands, differences, environments, included, reference, settings, source
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_GENERATORS = {
    "algorithm-code": algorithm.algorithm_code,
    "algorithm-map": algorithm.algorithm_map,
    "commands": commands.commands,
    "curves": included.curves,
    "deviations": differences.deviations,
    "environments": environments.overview,
    "examples": source.examples,
    "excerpt": lambda page, name: source.excerpt(name),  # noqa: ARG005
    "face": reference.face,
    "file": lambda page, name: source.listing(name),  # noqa: ARG005
    "include": lambda page, name: included.included(name, page),
    "module": reference.module,
    "room": reference.room,
    "settings": settings.settings,
}
_DIRECTIVE = re.compile(r"^<!-- generated: (\S+)(.*?) -->$", flags=re.MULTILINE)
_NAME = re.compile(r"\[\[(shes[\w.]*)\]\]")


def on_config(config: MkDocsConfig) -> None:
    """Put the environments' pages into the navigation."""
    source.tree.cache_clear()
    pages = [environments.page_uri(name) for name in environments.ENVIRONMENTS]
    for item in config.nav or []:
        for children in item.values():
            if isinstance(children, list) and children[0] == "environments/index.md":
                children[1:] = pages


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add what is made from the code: environments with their pictures, source pages, files that pages link to."""
    make = partial(File.generated, config)
    for name in environments.ENVIRONMENTS:
        files.append(make(environments.page_uri(name), content=environments.environment_page(name)))
        files.append(make(environments.picture_uri(name), content=environments.picture(name)))
    for path in source.modules():
        files.append(make(source.page_uri(path), content=source.page(path)))
    for uri, path in included.attachments().items():
        files.append(make(uri, abs_src_path=str(path)))


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Fill the places left for the code."""
    uri = page.file.src_uri
    if uri.startswith("source/"):
        return markdown

    def generated(match: re.Match[str]) -> str:
        return _GENERATORS[match[1]](uri, *match[2].split())

    def named(match: re.Match[str]) -> str:
        path, line, _ = source.find(match[1])
        return source.link(path, line, uri)

    try:
        return _NAME.sub(named, _DIRECTIVE.sub(generated, markdown))
    except LookupError as error:
        raise PluginError(f"{uri}: {error}") from error
