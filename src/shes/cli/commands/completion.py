"""`shes completion`: a script that teaches a shell the command's words."""

from __future__ import annotations

import importlib
from contextlib import suppress
from typing import Annotated, Literal

import tyro

from shes.cli.parsing import program_of
from shes.cli.program import COMMANDS


def completion(shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional]) -> int:
    """Print a script by which a shell completes commands, flags, environments and other names by the tab key.

    Do it again after an update. For bash: shes completion bash > ~/.shes.bash; echo '. ~/.shes.bash' >> ~/.bashrc

    Args:
        shell: The shell that the script is for.
    """
    programs = {}
    for name in COMMANDS:
        module = importlib.import_module(f"shes.cli.commands.{name}")
        programs[name] = program_of(getattr(module, f"{name}_" if name == "list" else name), [])
    arguments = ["--tyro-print-completion", shell]
    with suppress(SystemExit):  # tyro prints the script and leaves
        tyro.extras.subcommand_cli_from_dict(programs, prog="shes", args=arguments, config=(tyro.conf.OmitArgPrefixes,))
    return 0
