"""The page of a report: its HTML, with plotly.js inside."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import shes.viewing
from shes.errors import MissingExtraError
from shes.viewing.report_figures import Figure


def read_plotly() -> str:
    """Return the program plotly.js; raise MissingExtraError if plotly is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise MissingExtraError(f"a report needs plotly ({error}). Install it: pip install 'shes[report]'.") from error
    return get_plotlyjs().replace("</script", "<\\/script")


def page(title: str, subtitle: str, body: Iterable[str], figures: Mapping[str, Figure], plotly: str) -> str:
    """Return the page with the sections `body`, HTML, and the `figures` by the names of their places."""
    template = (files(shes.viewing) / "report_page.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        body="\n".join(body),
        plotly=plotly,
        figures=json.dumps(figures, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def section(title: str, *parts: str) -> str:
    """Return a section of the page; empty without `parts`."""
    content = "\n".join(filter(None, parts))
    return f"<section>\n<h2>{escape(title)}</h2>\n{content}\n</section>" if content else ""


def paragraph(text: str, kind: str = "hint") -> str:
    """Return a paragraph of class `kind`."""
    return f'<p class="{kind}">{escape(text)}</p>'


def table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; empty without rows."""
    lines = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows]
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    whole = f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'
    return whole if lines else ""


def plot(name: str) -> str:
    """Return the place of the figure `name`."""
    return f'<div class="plot" id="{escape(name)}"></div>'
