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


def details(summary: str, content: str, *, is_heading: bool = False) -> str:
    """Return `content` that is shown on demand; empty if it is. The summary may be the heading of a section."""
    shown = f"<h2>{escape(summary)}</h2>" if is_heading else escape(summary)
    return f"<details><summary>{shown}</summary>\n{content}</details>" if content else ""


def plots(names: Iterable[str]) -> str:
    """Return places for figures, each below its title, in a grid; empty without `names`."""
    places = [
        f'<figure><figcaption></figcaption><div class="plot" data-figure="{escape(name)}"></div></figure>'
        for name in names
    ]
    return f'<div class="plots">{"".join(places)}</div>' if places else ""


def toolbar(content: str, axes: Iterable[str] = X_AXES, *, has_legend: bool = True) -> str:
    """Return `content` below the choice of its horizontal axis and the place of the legend of runs; empty if it is.

    The choice, one of `axes`, stays in the window as long as the content is.
    """
    if not content:
        return ""
    choices = "".join(
        f'<label><input type="radio" name="x" value="{name}" autocomplete="off"{" checked" * (number == 0)}> '
        f"{X_AXES[name][0]}</label>"
        for number, name in enumerate(axes)
    )
    legend = '<div id="legend"></div>' if has_legend else ""
    return f'<div>\n<form class="bar"><fieldset>{choices}</fieldset>{legend}</form>\n{content}\n</div>'


def map_card(name: str, title: str, subtitle: str, episodes: Sequence[str] = ()) -> str:
    """Return the place of map `name`, with a choice of one of its `episodes`, if it has any."""
    options = "".join(f'<option value="{number}">{escape(each)}</option>' for number, each in enumerate(episodes))
    choice = f'<select data-map="{name}" autocomplete="off"><option value="">all episodes</option>{options}</select>'
    return (
        f'<div class="card">{heading(title, subtitle)}{f"<label>Show {choice}</label>" if episodes else ""}'
        f'<div class="plot map" data-figure="{name}"></div></div>'
    )


def video_card(title: str, subtitle: str, uri: str) -> str:
    """Return a video."""
    video = f'<video controls loop muted playsinline src="{uri}"></video>'
    return f'<div class="card">{heading(title, subtitle)}{video}</div>'


def image_card(title: str, uri: str) -> str:
    """Return a picture."""
    return f'<div class="card">{heading(title)}<img alt="{escape(title)}" src="{uri}"></div>'


def heading(title: str, subtitle: str = "") -> str:
    """Return a heading within a section, with a line below."""
    return f"<h3>{escape(title)}</h3>" + (paragraph(subtitle, "hint") if subtitle else "")


def cards(each: Iterable[str], kind: str = "") -> str:
    """Return cards in a grid, one in a row if they are of kind `wide`; empty if there are none."""
    found = "\n".join(each)
    return f'<div class="{f"maps {kind}".strip()}">{found}</div>' if found else ""
