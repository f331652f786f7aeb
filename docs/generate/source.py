"""The code as pages with numbered lines, and where in it a name is defined: what every link into the code leads to."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer

from generate.tables import table

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""
_SRC = ROOT / "src"


class UnknownCodeError(LookupError):
    """A page names code that does not exist."""


def modules() -> list[Path]:
    """Return every Python file of the package, in alphabetical order."""
    return sorted((_SRC / "shes").rglob("*.py"))


def label(path: Path) -> str:
    """Return how a file is named in the text: `src/shes/algorithms/evolution/algorithm.py`."""
    return path.relative_to(ROOT).as_posix()


def module_name(path: Path) -> str:
    """Return the name that `path` is imported by: `shes.algorithms.evolution.algorithm`."""
    parts = path.relative_to(_SRC).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def page_uri(path: Path) -> str:
    """Return the page that shows `path`: `source/algorithm.md`."""
    return f"source/{path.relative_to(_SRC / 'shes').with_suffix('.md').as_posix()}"


def relative(uri: str, page: str) -> str:
    """Return the link to `uri` on `page`."""
    parts, base = PurePosixPath(uri).parts, PurePosixPath(page).parent.parts
    shared = next((i for i, (a, b) in enumerate(zip(parts, base, strict=False)) if a != b), min(len(parts), len(base)))
    return "/".join(("..",) * (len(base) - shared) + parts[shared:])


def link(path: Path, line: int, page: str, text: str = "") -> str:
    """Return the Markdown link to a line of the code, to be written on `page`; by default it shows where it leads."""
    place = f"`{path.relative_to(_SRC / 'shes').as_posix()}:{line}`"
    return f"[{text or place}]({relative(page_uri(path), page)}#L-{line})"


def page(path: Path) -> str:
    """Return the page that shows `path`."""
    html = highlight(path.read_text(encoding="utf-8"), PythonLexer(), HtmlFormatter(linespans="L", wrapcode=True))
    width = len(str(html.count('id="L-')))
    numbered = re.sub(
        r'<span id="L-(\d+)">',
        lambda line: f'{line[0]}<span class="linenos" data-linenos="{line[1]:>{width}} "></span>',
        html,
    )
    head = f"---\ntitle: {label(path)}\nhide: [navigation, toc]\nsearch: {{exclude: true}}\n---"
    return f"{head}\n\n# `{label(path)}`\n\n{numbered}\n"


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of `path`."""
    return ast.parse(path.read_text(encoding="utf-8"))


def find(name: str) -> tuple[Path, int, int]:
    """Return the file, first line and last line of a module or of what is defined in one: `shes.es.level.perturb`.

    Raises:
        UnknownCodeError: There is no such thing.
    """
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        stem = _SRC.joinpath(*parts[:length])
        for path in (stem.with_suffix(".py"), stem / "__init__.py"):
            if path.is_file():
                first, last = 1, len(path.read_text(encoding="utf-8").splitlines())
                body = tree(path).body
                for part in parts[length:]:
                    node = _definition(body, part)
                    if node is None:
                        raise UnknownCodeError(f"{label(path)} defines no {part!r} ({name}).")
                    body = getattr(node, "body", [])
                    first, last = node.lineno, node.end_lineno or node.lineno
                return path, first, last
    raise UnknownCodeError(f"there is no module {name!r}.")


def _definition(body: list[ast.stmt], name: str) -> ast.stmt | None:
    """Return the statement of `body` that defines `name`."""
    for node in body:
        targets: list[ast.expr] = []
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return node
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            return node
    return None


def excerpt(name: str, marked: tuple[int, ...] = ()) -> str:
    """Return the code of `name` as a fenced block with its line numbers; `marked` lines stand out."""
    path, first, last = find(name)
    lines = path.read_text(encoding="utf-8").splitlines()[first - 1 : last]
    stand_out = " ".join(str(line - first + 1) for line in marked if first <= line <= last)
    options = f'linenums="{first}" title="{label(path)}"' + (f' hl_lines="{stand_out}"' if stand_out else "")
    return "\n".join([f"```python {options}", *lines, "```"])


def listing(name: str) -> str:
    """Return a file of the repository as a fenced block, without what its first lines tell the linter."""
    lines = (ROOT / name).read_text(encoding="utf-8").strip().splitlines()
    while lines[0].startswith("# ruff:"):
        del lines[0]
    return "\n".join([f'```python title="{name}"', *lines, "```"])


def examples(page: str) -> str:
    """Return the table of the programs in `examples`."""
    del page
    found = {path.name: ast.get_docstring(tree(path)) or "" for path in sorted((ROOT / "examples").glob("*.py"))}
    return table(["program", "what it shows"], [(f"`{name}`", text.split("\n\n")[0]) for name, text in found.items()])


def comments(path: Path) -> Iterator[tuple[int, str]]:
    """Yield every comment of `path` with its line."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
