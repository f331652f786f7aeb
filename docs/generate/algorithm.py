"""Which line of Algorithm 1 stands where in the code: from the comments that mark it."""

from __future__ import annotations

import re
from pathlib import Path

from generate.source import comments, excerpt, find, link, modules
from generate.tables import table

_C, _P = "<sup>c</sup>", "<sup>p</sup>"
_PSEUDOCODE = {
    1: "**for** t = 0, 1, 2, … **do**",
    2: "**for** i = 1, 2, …, n **do**",
    3: f"sample ε{_C}, ε{_P} ~ N(0, I);<br>f{_C}, f{_P} = F(θ{_C} + σ ε{_C}, θ{_P} + σ ε{_P})",
    4: f"θ{_C} ← θ{_C} + α · 1/(n σ) · Σ f{_C} ε{_C}",
    5: f"θ{_P} ← θ{_P} + α · 1/(n σ) · Σ f{_P} ε{_P}",
}
_MARKER = re.compile(r"\blines? (\d)(?: and (\d)|, (\d))?")


def markers() -> list[tuple[int, Path, int]]:
    """Return every marked place of the code: line of Algorithm 1, file, line of the file."""
    return [
        (int(number), path, line)
        for path in modules()
        for line, comment in comments(path)
        if re.match(r"# lines? \d", comment)
        for match in _MARKER.finditer(comment)
        for number in match.groups()
        if number
    ]


def algorithm_map(page: str) -> str:
    """Return the table from the lines of Algorithm 1 to lines of the code."""
    found = markers()
    rows = []
    for number, text in _PSEUDOCODE.items():
        places = [link(path, line, page) for marked, path, line in found if marked == number]
        if not places:
            raise LookupError(f"no comment in src/shes marks line {number} of Algorithm 1.")
        rows.append((number, text, "<br>".join(places)))
    return table(["line", "Algorithm 1", "where"], rows)


def algorithm_code(page: str) -> str:
    """Return the code of the loop, with the marked lines standing out."""
    del page
    path, _, _ = find("shes.algorithms.evolution.algorithm")
    return excerpt(
        "shes.algorithms.evolution.algorithm.evolve", tuple(line for _, where, line in markers() if where == path)
    )
