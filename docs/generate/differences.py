"""Every deviation from the paper and from its code that the code itself states."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from generate.source import link, module_name, modules, tree
from generate.tables import table

_START = re.compile(r"^\s*(?:#\s*)?(?:\"\"\")?Deviation:\s*(.*)")


def deviations(page: str) -> str:
    """Return the table of all `Deviation:` passages of docstrings and comments."""
    rows = []
    for path in modules():
        for line, text in _passages(path):
            rows.append((link(path, line, page, f"`{_owner(path, line)}`"), text))
    return table(["where", "deviation"], rows)


def _passages(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of every passage: up to an empty line, the end of the docstring or of the comment."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        match = _START.match(line)
        if not match:
            continue
        is_comment = line.lstrip().startswith("#")
        words = [match[1]]
        for following in lines[number:]:
            text = following.strip()
            if words[-1].endswith('"""') or not text.strip('"') or text.startswith("#") != is_comment:
                break
            words.append(text.lstrip("# ") if is_comment else text)
        yield number, " ".join(words).removesuffix('"""').strip()


def _owner(path: Path, line: int) -> str:
    """Return the name of what the docstring or comment at `line` belongs to."""
    owner = module_name(path)
    body: list[ast.stmt] = tree(path).body
    while True:
        for before, node in zip([None, *body], body, strict=False):
            if not node.lineno <= line <= (node.end_lineno or node.lineno):
                continue
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                owner, body = f"{owner}.{node.name}", node.body
                break
            if isinstance(node, ast.Expr) and isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name):
                return f"{owner}.{before.target.id}"
            return owner
        else:
            return owner
