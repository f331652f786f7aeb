"""The script for bash, from version 3.2 on."""

from __future__ import annotations

from collections.abc import Sequence

from shes.cli.completion.offers import ALONE, Offer, agents_for, is_path
from shes.cli.options import Option

__all__ = ["bash_script"]

_SCRIPT = """\
# Completion of the shes command for bash; made by `shes completion bash`.
_shes() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD - 1]}}
    local command= flags= names= values= folders= agents= word group groups=() index IFS=$' \\t\\n'
    # bash takes --preset=paper for three words.
    [[ $current == "=" ]] && current=
    [[ $previous == "=" ]] && previous=${{COMP_WORDS[COMP_CWORD - 2]}}
    for ((index = 1; index < COMP_CWORD; index++)); do
        word=${{COMP_WORDS[index]}}
        if [[ $word == --import ]]; then
            [[ ${{COMP_WORDS[index + 1]}} == "=" ]] && ((index++))
            ((index++))
        elif [[ $word != -* ]]; then
            command=$word
            break
        fi
    done
    case "$command $previous" in
{values}
    *" --import") return ;;
    esac
    case "$command" in
{commands}
    esac
    # The first group of names of which none is there yet.
    for group in ${{groups[@]+"${{groups[@]}}"}}; do
        for word in "${{COMP_WORDS[@]:index + 1:COMP_CWORD - index - 1}}"; do
            [[ " $group " == *" $word "* ]] && continue 2
        done
        names=$group
        break
    done
    if [[ $values == "(path)" || (-n $folders && -z $values && $current != -*) ]]; then
        names=$(compgen -W "$agents" -- "$current")
        IFS=$'\\n'
        COMPREPLY=($names $(compgen $([[ $values ]] && echo -f || echo -d) -- "$current"))
        compopt -o filenames 2>/dev/null
        return
    fi
    if [[ -z $values ]]; then
        [[ $current == -* || -z $names ]] && values=$flags || values=$names
    fi
    COMPREPLY=($(compgen -W "$values" -- "$current"))
}}
complete -F _shes shes
"""


def bash_script(offers: Sequence[Offer]) -> str:
    """Return the script."""
    values: list[str] = []
    commands = [f'    "") groups=("{" ".join(offer.name for offer in offers)}") flags="{" ".join(ALONE)}" ;;']
    for offer in offers:
        free: list[str] = []
        for option in offer.flagged:
            words = " ".join(option.choices) or ("(path)" if is_path(option) else "")
            places = [f'"{offer.name} {flag}"' for flag in option.flags]
            agents = _agents(option)
            if words:
                values.append(f'    {" | ".join(places)}) values="{words}"{agents} ;;')
            elif not option.is_switch:
                free += places
        if free:
            values.append(f"    {' | '.join(free)}) return ;;")
        groups = " ".join(f'"{" ".join(option.choices)}"' for option in offer.positionals if option.choices)
        paths = [option for option in offer.positionals if is_path(option)]
        folders = f" folders=1{_agents(paths[0])}" if paths else ""
        commands.append(f'    {offer.name}) groups=({groups}) flags="{" ".join(offer.flags)}"{folders} ;;')
    return _SCRIPT.format(values="\n".join(values), commands="\n".join(commands))


def _agents(option: Option) -> str:
    """Return what offers the shipped agents in the place of `option`; nothing if none may stand there."""
    names = " ".join(agents_for(option))
    return f' agents="{names}"' if names else ""
