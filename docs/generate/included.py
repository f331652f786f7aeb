"""Files of the repository that are pages too (changelog, results), with their links led to where they are here."""

from __future__ import annotations

import re
from pathlib import Path

from generate.source import ROOT, modules, page_uri, relative

PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "results/README.md": "results.md"}
"""Files of the repository that have a page."""
_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")


def included(name: str, page: str) -> str:
    """Return file `name` of the repository as text of `page`."""
    return _LINK.sub(lambda match: f"{match[1]}({_target(name, match[2], page)})", _text(name))


def attachments() -> dict[str, Path]:
    """Return the files that the included ones link to, and the pictures among the results, by where they are put."""
    found = {_attachment_uri(path): path for path in _pictures()}
    for name in PAGES:
        for _, target in _LINK.findall(_text(name)) if name != "README.md" else ():
            path = _path(name, target)
            if path is not None and path.is_file() and path.suffix not in (".py", ".md"):
                found[_attachment_uri(path)] = path
    return found


def curves(page: str) -> str:
    """Return the pictures among the results, for `page`."""
    parts = []
    for path in _pictures():
        name = f"{path.parent.name}: {path.stem}"
        parts.append(f"`{path.parent.name}`\n\n![{name}]({relative(_attachment_uri(path), page)})")
    return "\n\n".join(parts)


def _pictures() -> list[Path]:
    return sorted((ROOT / "results").rglob("*.png"))


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _path(name: str, target: str) -> Path | None:
    """Return what `target` means in file `name`; none if it is not in the repository."""
    if re.match(r"[a-z]+:", target) or target.startswith("#"):
        return None
    return ((ROOT / name).parent / target.partition("#")[0]).resolve()


def _attachment_uri(path: Path) -> str:
    return f"files/{path.relative_to(ROOT).as_posix()}"


def _target(name: str, target: str, page: str) -> str:
    """Return the link of `page` that leads where `target` leads in file `name`."""
    path = _path(name, target)
    if path is None:
        return target
    anchor = target.partition("#")[2]
    if path in modules():
        return relative(page_uri(path), page) + (f"#L-{anchor.removeprefix('L')}" if anchor else "")
    if path.is_relative_to(ROOT) and (uri := PAGES.get(path.relative_to(ROOT).as_posix())):
        return relative(uri, page) + (f"#{anchor}" if anchor else "")
    if not path.is_file():
        raise FileNotFoundError(f"{name} links to {target}, which is no file.")
    return relative(_attachment_uri(path), page)
