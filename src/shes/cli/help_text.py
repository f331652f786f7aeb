"""The help of a command, and of all of them: plain text, as wide as the terminal up to 100 columns."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence

from shes.cli.command import Command
from shes.cli.options import Group, Option, options_in
from shes.cli.values import usage, written

__all__ = ["command_help", "overview"]

_EVERYWHERE = (
    ("-h, --help", "Show this help."),
    (
        "--import MODULE",
        "Import a module first: what it registers (environments, ...) is known then. Repeatable.",
    ),
    ("--debug", "Show the traceback of an error."),
)
_COLUMN = 26  # where texts begin
_WIDEST = 100


def overview(summaries: Mapping[str, str]) -> str:
    """Return the help of the command without a subcommand."""
    width = max(len(name) for name in summaries)
    lines = [
        "usage: shes COMMAND ...",
        "",
        "Scalable hierarchical evolution strategies: train, look, measure.",
        "",
        _heading("commands"),
        *(f"  {name:<{width}}  {text}" for name, text in summaries.items()),
        "",
        _heading("everywhere"),
        *_rows(_EVERYWHERE),
        "",
        *_wrapped(
            "`shes COMMAND --help` explains a command. First steps: shes train point-gather --generations 60, then "
            "shes plot RUN, then shes train ant-gather. Completion by the tab key: shes completion --help."
        ),
    ]
    return "\n".join(lines)


def command_help(command: Command, groups: Sequence[Group], notes: str = "") -> str:
    """Return the help of `command`, whose options are `groups`."""
    lines = [f"usage: {usage(options_in(groups), command.name)}", "", *_wrapped(command.description), ""]
    if command.examples:
        lines += [_heading("examples"), *(f"  {example}" for example in command.examples), ""]
    if notes:
        lines += [*_wrapped(notes), ""]
    for group in groups:
        lines += [_heading(group.heading), *_rows(_row(option) for option in group.options), ""]
    return "\n".join([*lines, _heading("everywhere"), *_rows(_EVERYWHERE)])


def _row(option: Option) -> tuple[str, str]:
    default = f"(default: {option.default})" if option.default else ""
    return written(option), " ".join(part for part in (option.text, default) if part)


def _rows(rows: Iterable[tuple[str, str]]) -> list[str]:
    """Return names and texts in two columns; a name that is too long has a line of its own."""
    lines: list[str] = []
    for name, text in rows:
        indent = " " * _COLUMN
        body = textwrap.wrap(text, _width(), initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
        head = f"  {name}"
        if len(head) + 2 <= _COLUMN and body:
            body[0] = f"{head:<{_COLUMN}}{body[0].lstrip()}"
            lines += body
        else:
            lines += [head, *body]
    return lines


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _width(), break_on_hyphens=False)


def _width() -> int:
    return max(_COLUMN + 20, min(_WIDEST, shutil.get_terminal_size().columns))


def _heading(text: str) -> str:
    """Return a heading, bold where that can be seen."""
    is_plain = not sys.stdout.isatty() or "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb"
    return f"{text}:" if is_plain else f"\x1b[1m{text}:\x1b[0m"
