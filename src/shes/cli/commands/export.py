"""`shes export`: a trained agent as files that need no SHES."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from shes.cli.output import print_line
from shes.cli.parsing import Checkpoint, Run


def export(
    run: Run,
    *,
    format: Literal["npz", "onnx"] = "npz",  # noqa: A002 - the flag
    out: Path | None = None,
    checkpoint: Checkpoint = "best",
) -> int:
    """Write a run's policy, with its normalisation, to a file that needs no SHES.

    npz holds the networks and a description in JSON, and examples/run_exported.py runs it with NumPy alone. onnx (extra
    onnx) holds one graph for each level; with two levels the files are NAME-controller.onnx and NAME-primitive.onnx.

    shes export ant-gather --format onnx --out gather.onnx

    Args:
        format: Format of the file.
        out: The file; policy.npz or policy.onnx if none.
    """
    from shes.training.export import export as write

    for path in write(run, out, format=format, checkpoint=checkpoint):
        print_line(f"Policy: {path}")
    return 0
