"""The command line's own help."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from contextlib import redirect_stdout
from unittest.mock import patch

from shes.cli import main
from shes.cli.program import COMMANDS

_TERMINAL = {"COLUMNS": "96", "NO_COLOR": "1", "TERM": "dumb"}


def help_text(words: Sequence[str]) -> str:
    """Return what `shes WORDS... --help` prints."""
    out = io.StringIO()
    with patch.dict(os.environ, _TERMINAL), redirect_stdout(out):
        try:
            code = main([*words, "--help"])
        except SystemExit as end:
            code = end.code
    if code not in (0, None):
        raise RuntimeError(f"shes {' '.join(words)} --help ended with exit code {code}.")
    return "\n".join(line.rstrip() for line in out.getvalue().strip("\n").splitlines())


def commands(page: str) -> str:
    """Return a section with the help of every command."""
    del page
    parts = [_block("shes --help", help_text([]))]
    for name in COMMANDS:
        parts += [f"## {name}", _block(f"shes {name} --help", help_text([name]))]
    return "\n\n".join(parts)


def _block(title: str, text: str) -> str:
    return f'```{{ .text .help title="{title}" }}\n{text}\n```'
