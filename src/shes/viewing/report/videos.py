"""Short videos of runs, as data URIs."""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path

from shes.viewing.render import render
from shes.viewing.report.reading import ReportedRun

_STEPS = 150
"""Control steps of a video: 15 s of the package's robots."""
_PIXELS = 320


def video_uri(run: ReportedRun, seed: int | None = None) -> str:
    """Return a video of the first steps of a run's first fresh episode; raise ShesError if it cannot be made."""
    steps = min(_STEPS, run.config.evaluation_steps)
    with tempfile.TemporaryDirectory(prefix="shes-report-") as folder:
        out = render(run.folder.path, Path(folder) / "walk.mp4", size=_PIXELS, steps=steps, seed=seed)
        return f"data:video/mp4;base64,{base64.b64encode(out.read_bytes()).decode()}"
