"""Completion by the tab key: scripts of plain shell, made from the options of the commands; no Python runs on a tab."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shes.cli.completion.bash import bash_script
from shes.cli.completion.fish import fish_script
from shes.cli.completion.offers import Offer, gather_offers
from shes.cli.completion.tcsh import tcsh_script
from shes.cli.completion.zsh import zsh_script

__all__ = ["SCRIPTS", "gather_offers"]

SCRIPTS: dict[str, Callable[[Sequence[Offer]], str]] = {
    "bash": bash_script,
    "zsh": zsh_script,
    "fish": fish_script,
    "tcsh": tcsh_script,
}
"""What makes the script, by shell."""
