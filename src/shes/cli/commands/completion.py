"""`shes completion`: a script by which a shell completes the command line."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Literal

import tyro

from shes.cli.parsing import program_of
from shes.cli.program import COMMANDS, find_command
from shes.errors import MissingExtraError

_BASH = """\
_shes() {
  local line
  COMPREPLY=()
  while IFS= read -r line; do
    [ -z "$line" ] || COMPREPLY+=("$line")
  done < <("${COMP_WORDS[0]}" --complete "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)
}
complete -o default -F _shes shes"""


def completion(shell: Annotated[Literal["bash", "zsh", "fish", "tcsh"], tyro.conf.Positional]) -> int:
    """Print a script by which a shell completes the command line with the Tab key.

    bash completes commands, flags, environments, runs, shipped agents and other names. The other shells complete
    commands, their flags (of train, those of ant-gather) and the choices of a flag; print these again after an update.
    For bash: shes completion bash > ~/.shes.bash; echo '. ~/.shes.bash' >> ~/.bashrc

    Args:
        shell: The shell. tcsh needs the package shtab.
    """
    if shell == "bash":
        print(_BASH)
        return 0
    programs = {name: program_of(find_command(name)) for name in COMMANDS}
    arguments = ["--tyro-print-completion", shell]
    try:
        with suppress(SystemExit):  # tyro prints the script and exits
            tyro.extras.subcommand_cli_from_dict(
                programs, prog="shes", args=arguments, config=(tyro.conf.OmitArgPrefixes,)
            )
    except ImportError as error:
        raise MissingExtraError(f"completion for {shell} needs shtab (pip install shtab): {error}") from error
    return 0
