"""The script for tcsh. Its rules look at one word alone, so that every flag is offered to every command."""

from __future__ import annotations

from collections.abc import Sequence

from shes.cli.completion.offers import ALONE, Offer, is_path

__all__ = ["tcsh_script"]


def tcsh_script(offers: Sequence[Offer]) -> str:
    """Return the script."""
    rules: dict[str, None] = {}
    flags: dict[str, None] = {}
    for offer in offers:
        flags |= dict.fromkeys(flag[2:] for flag in offer.flags)
        for option in offer.flagged:
            if words := _words(option.choices, "f" if is_path(option) else ""):
                rules |= dict.fromkeys(f"'n/{flag}/{words}/'" for flag in option.flags)
        for option in offer.positionals[:1]:
            if words := _words(option.choices, "d" if is_path(option) else ""):
                rules[f"'n/{offer.name}/{words}/'"] = None
    flags |= dict.fromkeys(flag[2:] for flag in ALONE)
    names = " ".join(offer.name for offer in offers)
    lines = [f"'c/--/({' '.join(flags)})/'", *rules, f"'p/1/({names})/'"]  # the first rule that fits is taken
    return "\n".join(
        [
            "# Completion of the shes command for tcsh; made by `shes completion tcsh`.",
            "complete shes \\",
            *(f"    {line} \\" for line in lines[:-1]),
            f"    {lines[-1]}",
            "",
        ]
    )


def _words(choices: Sequence[str], otherwise: str) -> str:
    return f"({' '.join(choices)})" if choices else otherwise
