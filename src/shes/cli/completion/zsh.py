"""The script for zsh: sourced, or as a file `_shes` in a folder of `fpath`."""

from __future__ import annotations

from collections.abc import Sequence

from shes.cli.completion.offers import EVERYWHERE, Offer, agents_for, brief, is_path
from shes.cli.options import Option

__all__ = ["zsh_script"]

_SCRIPT = """\
#compdef shes
# Completion of the shes command for zsh; made by `shes completion zsh`.
_shes() {{
    local command=$words[2]
    if ((CURRENT == 2)); then
        local -a commands=(
{commands}
        )
        _describe command commands
        return
    fi
    shift words
    ((CURRENT--))
    case $command in
{cases}
    esac
}}
if [[ $funcstack[1] == _shes ]]; then
    _shes "$@"
else
    (($+functions[compdef])) || {{ autoload -Uz compinit && compinit; }}
    compdef _shes shes
fi
"""


def zsh_script(offers: Sequence[Offer]) -> str:
    """Return the script."""
    commands = [f"            {_quoted(f'{offer.name}:{offer.summary}')}" for offer in offers]
    cases: list[str] = []
    for offer in offers:
        rules = [_positional(option, place) for place, option in enumerate(offer.positionals, 1)]
        rules += [_flag(flag, option) for option in offer.flagged for flag in option.shown_flags]
        for flag, text in EVERYWHERE.items():
            takes, value = ("=", ":MODULE: ") if flag == "--import" else ("", "")
            rules.append(_quoted(f"{flag}{takes}{_described(text)}{value}"))
        cases.append(f"    {offer.name})")
        cases.append(" \\\n".join(["        _arguments", *(f"            {rule}" for rule in rules)]))
        cases.append("        ;;")
    return _SCRIPT.format(commands="\n".join(commands), cases="\n".join(cases))


def _positional(option: Option, place: int) -> str:
    return _quoted(f"{'*' if option.takes_many else place}:{option.noun}:{_values(option)}")


def _flag(flag: str, option: Option) -> str:
    text = _described(brief(option.text))
    return _quoted(f"{flag}{text}" if option.is_switch else f"{flag}={text}:value:{_values(option)}")


def _values(option: Option) -> str:
    if is_path(option):
        files, names = "_files" if option.flags else "_files -/", " ".join(agents_for(option))
        return f"{{compadd -- {names}; {files}}}" if names else files
    return f"({' '.join(option.choices)})" if option.choices else " "


def _described(text: str) -> str:
    escaped = "".join(f"\\{letter}" if letter in "[]:\\" else letter for letter in text)
    return f"[{escaped}]"


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"
