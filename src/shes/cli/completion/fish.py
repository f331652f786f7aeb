"""The script for fish."""

from __future__ import annotations

from collections.abc import Sequence

from shes.cli.completion.offers import ALONE, EVERYWHERE, Offer, agents_for, brief, is_path

__all__ = ["fish_script"]


def fish_script(offers: Sequence[Offer]) -> str:
    """Return the script."""
    alone = "-n __fish_use_subcommand"
    lines = ["# Completion of the shes command for fish; made by `shes completion fish`.", "complete -c shes -f"]
    lines += [f"complete -c shes {alone} -a {offer.name} -d {_quoted(offer.summary)}" for offer in offers]
    lines += [_flag(alone, flag, text, " -x" * (flag == "--import")) for flag, text in ALONE.items()]
    for offer in offers:
        here = f"-n '__fish_seen_subcommand_from {offer.name}'"
        for option in offer.positionals:
            words = " ".join(option.choices)
            if is_path(option):
                words = " ".join(("(__fish_complete_directories)", *agents_for(option)))
            lines.append(f"complete -c shes {here} -a {_quoted(words)} -d {_quoted(option.noun)}")
        for option in offer.flagged:
            value = f" -x -a {_quoted(' '.join(option.choices))}" if option.choices else " -x"
            if is_path(option):
                names = " ".join(agents_for(option))
                value = f" -r -F -a {_quoted(names)}" if names else " -r -F"
            value = "" if option.is_switch else value
            lines += [_flag(here, flag, brief(option.text), value) for flag in option.shown_flags]
        lines += [_flag(here, flag, text, " -x" * (flag == "--import")) for flag, text in EVERYWHERE.items()]
    return "\n".join(lines) + "\n"


def _flag(condition: str, flag: str, text: str, value: str) -> str:
    return f"complete -c shes {condition} -l {flag[2:]}{value} -d {_quoted(text)}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
