"""`shes report`: runs as one page of HTML."""

from __future__ import annotations

import signal
import sys
from typing import Annotated, Any

import tyro

import shes
from shes.cli.output import make_console, print_line

_TERMINATED = 143
_Runs = Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(required)")]


def report(runs: _Runs, **options: Annotated[Any, "shes.viewing.report.report.report"]) -> int:
    """Make one HTML page of runs: curves, results on fresh episodes, maps, videos, settings.

    The page needs no network. Making it needs plotly (extra report). Without a graphics card a video takes half a
    minute; --no-video omits them.

    shes report runs/seeds runs/other --out report.html
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(_TERMINATED))  # so that workers and ffmpeg are ended
    with make_console(stderr=True).status("reading") as status:
        path = shes.report(runs, **options, on_stage=status.update)
    print_line(f"Report: {path}")
    return 0
