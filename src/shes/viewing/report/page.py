"""The page of a report: its HTML, with the style sheet, the program and plotly.js inside."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import shes.viewing.report
from shes.errors import MissingExtraError
from shes.viewing.report.curve_charts import X_AXES, Figure


def check_plotly() -> None:
    """Raise MissingExtraError if plotly is not installed."""
    try:
        import plotly.offline  # noqa: F401 - only whether it is there
    except ImportError as error:
        raise MissingExtraError(f"a report needs plotly ({error}). Install it: pip install 'shes[report]'.") from error


def page(
    title: str,
    subtitle: str,
    body: Iterable[str],
    figures: dict[str, Figure | dict[str, Figure]],
    axes: dict[str, list[dict[str, str]]],
) -> str:
    """Return the page.

    Args:
        title: Its title.
        subtitle: A line below.
        body: Its sections, HTML.
        figures: Figures by name; a figure for each of `X_AXES` if it depends on the horizontal axis.
        axes: Label, colour and dash of each curve over each of `X_AXES`.
    """
    from plotly.offline import get_plotlyjs

    data = {"x": next(iter(X_AXES)), "axes": axes, "figures": figures}
    return Template(_resource("page.html")).substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        body="\n".join(body),
        style=_resource("page.css"),
        script=_resource("page.js"),
        plotly=get_plotlyjs().replace("</script", "<\\/script"),
        figures=json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _resource(name: str) -> str:
    return (files(shes.viewing.report) / name).read_text(encoding="utf-8")


def section(title: str, *parts: str) -> str:
    """Return a section of the page; empty without `parts`."""
    parts = tuple(filter(None, parts))
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(parts) + "\n</section>" if parts else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of class `kind`."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(headings: Sequence[str], rows: Iterable[Sequence[Any]], kind: str = "") -> str:
    """Return a table of class `kind`; empty without rows."""
    lines = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows]
    if not lines:
        return ""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    return (
        f'<div class="scroll"><table class="{kind}"><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'
    )


def details(summary: str, content: str) -> str:
    """Return `content` that is shown on demand; empty if it is."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}</details>" if content else ""


def plots(names: Iterable[str]) -> str:
    """Return places for figures, in a grid; empty without `names`."""
    places = [f'<div class="plot" data-figure="{escape(name)}"></div>' for name in names]
    return f'<div class="plots">{"".join(places)}</div>' if places else ""


def toolbar() -> str:
    """Return the choice of the horizontal axis, and the place of the legend."""
    choices = "".join(
        f'<label><input type="radio" name="x" value="{name}" autocomplete="off"{" checked" * (number == 0)}> '
        f"{label}</label>"
        for number, (name, (label, *_)) in enumerate(X_AXES.items())
    )
    return f'<div class="bar"><fieldset>{choices}</fieldset><div id="legend"></div></div>'


def map_card(name: str, title: str, subtitle: str, episodes: Sequence[str]) -> str:
    """Return the place of map `name`, with a choice of one of its `episodes`."""
    options = "".join(f'<option value="{number}">{escape(each)}</option>' for number, each in enumerate(episodes))
    choice = f'<select data-map="{name}" autocomplete="off"><option value="">all episodes</option>{options}</select>'
    return (
        f'<div class="card">{_heading(title, subtitle)}<label>Show {choice}</label>'
        f'<div class="plot map" data-figure="{name}"></div></div>'
    )


def video_card(title: str, subtitle: str, uri: str) -> str:
    """Return a video."""
    video = f'<video controls loop muted playsinline src="{uri}"></video>'
    return f'<div class="card">{_heading(title, subtitle)}{video}</div>'


def image_card(title: str, uri: str) -> str:
    """Return a picture."""
    return f'<div class="card">{_heading(title, "")}<img alt="{escape(title)}" src="{uri}"></div>'


def _heading(title: str, subtitle: str) -> str:
    return f"<h3>{escape(title)}</h3>" + (paragraph(subtitle, "hint") if subtitle else "")


def cards(each: Iterable[str]) -> str:
    """Return cards in a grid; empty if there are none."""
    found = "\n".join(each)
    return f'<div class="maps">{found}</div>' if found else ""
