"""The docstrings under the fields of dataclasses, which Python itself discards."""

from __future__ import annotations

import ast
import inspect
import linecache
from functools import cache
from itertools import pairwise


@cache
def field_texts(cls: type) -> dict[str, str]:
    """Return the docstrings under the fields of a dataclass and its base classes, each on one line."""
    texts: dict[str, str] = {}
    for ancestor in (
        base for each in (*getattr(cls, "_option_classes", ()), cls) for base in reversed(each.__mro__[:-1])
    ):
        try:
            definition = _class_definitions(inspect.getsourcefile(ancestor) or "").get(ancestor.__qualname__)
        except (OSError, TypeError, SyntaxError):
            continue  # a class defined in a console has no source
        body = [] if definition is None else definition.body
        for statement, follower in pairwise(body):
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                text = follower.value if isinstance(follower, ast.Expr) else None
                if isinstance(text, ast.Constant):
                    texts[statement.target.id] = " ".join(str(text.value).split())
    return texts


@cache
def _class_definitions(file: str) -> dict[str, ast.ClassDef]:
    """Return the class definitions in a file by qualified name. `inspect.getsource` parses the file for each class."""
    found: dict[str, ast.ClassDef] = {}

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                found[prefix + child.name] = child
                visit(child, f"{prefix}{child.name}.")
            elif isinstance(child, ast.FunctionDef):
                visit(child, f"{prefix}{child.name}.<locals>.")
            elif isinstance(child, ast.stmt):
                visit(child, prefix)

    visit(ast.parse("".join(linecache.getlines(file))), "")
    return found
