"""The letters of shapes in docstrings and comments, primes included, are in the legend of docs/reference/index.md."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
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
