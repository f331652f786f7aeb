"""`shes --complete`: the words that may stand at the cursor of a shell, taken from the help."""

from __future__ import annotations

import glob
import io
import os
import re
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from unittest.mock import patch

from shes.cli.command_table import COMMANDS, EVERYWHERE, find_command, split_everywhere
from shes.cli.parsing import call
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.errors import ConfigError, ShesError
from shes.registry import import_registering
from shes.runs.shipped import shipped_names


def print_completions() -> int:
    """Print what may stand at the cursor of the line that a shell completes. If nothing, the shell completes files."""
    line = os.environ.get("COMP_LINE") or os.environ.get("COMMAND_LINE") or "shes "
    line = line[: int(os.environ.get("COMP_POINT", len(line)))]
    *before, typed = (f"{line}|").split()[1:]
    typed = typed.removesuffix("|")
    if typed.startswith("-") and "=" in typed:  # bash replaces what follows =
        name, _, typed = typed.partition("=")
        before.append(name)
    asked, words = split_everywhere(before)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        for module in asked.modules:
            with suppress(ConfigError):
                import_registering(module)
    possible: Iterable[str] = [*COMMANDS, *EVERYWHERE, "--version"]
    if before[-1:] == ["--import"]:
        possible = ()
    elif words:
        possible = _words_after(words, typed) if words[0] in COMMANDS else ()
    for word in possible:
        if word.startswith(typed):
            print(word)
    return 0


def _words_after(before: list[str], typed: str) -> list[str]:
    """Return the words that may follow `before`; the last one begins with `typed`."""
    text = io.TextIOWrapper(io.BytesIO(), "utf-8")
    with redirect_stdout(text), patch.dict(os.environ, COLUMNS="9999"), suppress(ShesError):
        call(before[0], find_command(before[0]), [*before[1:], "--help-all"])
    text.seek(0)
    places: list[str] = []
    flags: dict[str, list[str]] = {name: [] for name in EVERYWHERE}
    for cell in re.split(r"│\s*", text.read())[1:]:  # the usage comes first
        entry, *_ = re.split(r"\s{2,}", cell)  # --camera {both,follow,top}   Camera.
        words = re.findall(r"--[\w-]+", entry) if entry.startswith("-") else None
        values = [name for names in re.findall(r"\{(.*?)\}", entry) for name in names.split(",")]
        if entry == "ENV":
            values = [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS]
        elif re.match(r"RUN|FIRST|SECOND|--.*\bRUN$", entry):
            start = glob.escape(typed if "/" in typed else "runs/")
            runs = (glob.iglob(f"{start}*/{end}config.json") for end in ("", "*/"))  # noqa: PTH207 - may be absolute
            values = [*shipped_names(), *sorted(str(Path(file).parent) for files in runs for file in files)]
        if words is None:
            places += values
        else:
            flags |= dict.fromkeys(words, values)
    return list(flags) if typed.startswith("-") else flags.get(before[-1]) or places
