"""`shes completion`: a script that teaches a shell the command's words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of

_SHELLS = ("bash", "zsh", "fish", "tcsh")


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes completion` takes."""

    shell: Annotated[str, Shown(choices=_SHELLS, noun="the name of a shell")]
    """The shell that the script is for."""


def _run(values: dict[str, Any]) -> int:
    from shes.cli.completion import SCRIPTS, gather_offers
    from shes.errors import UnknownNameError

    shell = Arguments(**values).shell
    if shell not in SCRIPTS:
        raise UnknownNameError("shell", shell, SCRIPTS, "`shes completion --help` says how to install each.")
    print(SCRIPTS[shell](gather_offers()), end="")
    return 0


COMMAND = Command(
    name="completion",
    description=(
        "Print a script by which a shell completes commands, flags, environments, presets and other names by the tab "
        "key. Install it once, by the line for your shell, and open a new one; do it again after an update."
    ),
    examples=(
        "shes completion bash > ~/.shes-completion.bash && echo '. ~/.shes-completion.bash' >> ~/.bashrc",
        "shes completion zsh > ~/.shes-completion.zsh && echo '. ~/.shes-completion.zsh' >> ~/.zshrc",
        "shes completion fish > ~/.config/fish/completions/shes.fish",
        "shes completion tcsh > ~/.shes-completion.tcsh && echo 'source ~/.shes-completion.tcsh' >> ~/.tcshrc",
    ),
    groups=(Group(heading="shell", options=options_of(Arguments)),),
    run=_run,
    is_help_alone=True,
)
