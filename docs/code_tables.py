"""Markdown tables made from the code: settings, commands, public names, and deviations from the paper."""

from __future__ import annotations

import inspect
import io
import os
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import griffe  # a dependency of mkdocstrings-python
from markdown_table import table

import shes
from shes.algorithms.contract import PRESETS
from shes.cli import main
from shes.cli.program import COMMANDS
from shes.envs.named_environments import ENVIRONMENTS
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import ALGORITHMS
from shes.settings import Unasked, setting_fields

_SRC = Path(__file__).parents[1] / "src"
_TERMINAL = {"NO_COLOR": "1", "TERM": "dumb"}
_COLUMNS = {"wide": "96", "narrow": "42"}  # of a window and of a telephone; extra.css shows one of them
_DEVIATION = re.compile(r"^Deviation: (.+?)(?=\n\n|\n(?:Source|Deviation): |\Z)", flags=re.MULTILINE | re.DOTALL)


def commands() -> str:
    """Return a section with the help of every command."""
    return "\n\n".join([_help(), *(f"## {name}\n\n{_help(name)}" for name in COMMANDS)])


def _help(*words: str) -> str:
    """Return what `shes WORDS... --help` prints, as a code block for each width."""
    title = " ".join(("shes", *words, "--help"))
    blocks = []
    for width, columns in _COLUMNS.items():
        with patch.dict(os.environ, _TERMINAL | {"COLUMNS": columns}), redirect_stdout(io.StringIO()) as out:
            if code := main([*words, "--help"]):
                raise RuntimeError(f"{title} ended with exit code {code}.")
        blocks.append(f'```{{ .text .help .{width} title="{title}" }}\n{out.getvalue().strip()}\n```')
    return "\n\n".join(blocks)


def settings() -> str:
    """Return a table of the flags of `train` for each section: meaning, and value in every preset."""
    configs, by_gradients = (
        {
            preset: make_config("ant-gather", preset, {"algorithm": algorithm})
            for preset in dict.fromkeys((*ALGORITHMS[algorithm].presets, *PRESETS))
        }
        for algorithm in ("shes", "hiro")
    )
    of_every_run = {"environment", *(configs["laptop"].sections.keys() & by_gradients["laptop"].sections.keys())}
    parts = [*_sections(configs, {"environment"}), *_sections(by_gradients, of_every_run)]
    return "\n\n".join([*parts, "### Environment", _task_options()])


def _sections(configs: Mapping[str, TrainConfig], without: Collection[str]) -> Iterator[str]:
    """Yield the table of each section of `configs`, which are given by preset, but for those in `without`."""
    first = next(iter(configs.values()))
    for name, section in first.sections.items():
        if name in without:
            continue
        rows = [
            (f"`{each.flag}`", each.text, *(_shown(config.values[each.name]) for config in configs.values()))
            for each in map(first.settings.__getitem__, first.to_dict()[name])
            if each.name not in ("env", "preset")
        ]
        title = (type(section).__doc__ or "").partition(".")[0]
        yield f"### {title}"
        yield table(["flag", "meaning", *(f"`{preset}`" for preset in configs)], rows)


def _task_options() -> str:
    """Return the table of the options of all tasks."""
    found, tasks = {}, dict[str, dict[str, None]]()
    for environment in ENVIRONMENTS.values():
        for each in setting_fields(environment.task.Options).values():
            if not each.has(Unasked):
                found[each.name] = each
                tasks.setdefault(each.name, {})[environment.task.name] = None
    count = len({environment.task.name for environment in ENVIRONMENTS.values()})
    rows = [
        (
            f"`{each.flag}`",
            "every task" if len(tasks[name]) == count else ", ".join(tasks[name]),
            each.text,
            _shown(each.default),
        )
        for name, each in found.items()
    ]
    return table(["flag", "task", "meaning", "default"], rows)


_HYPERPARAMETERS = (
    *("generations", "population_size", "episodes_per_policy", "sigma", "learning_rate", "weight_decay", "hidden"),
    *("output_weights", "controller_interval", "controller_network", "controller_view", "controller_output"),
    "minimum_goal_distance",
    *("primitive_view", "goal_encoding", "symmetry", "clock_frequency", "primitive_estimate", "intervals"),
    *("primitive_population_size", "primitive_sigma", "primitive_learning_rate", "primitive_hidden", "fall_price"),
    *("max_tilt", "common_random_numbers", "fitness_shaping", "target", "explore"),
)
"""Settings of the method, in the order of its description."""


def hyperparameters() -> str:
    """Return the table of the method's settings in `paper.md`: those of the paper, and of `laptop` of each ant task."""
    columns = {"paper": make_config("ant-gather", "paper").values}
    columns |= {
        env.removeprefix("ant-").title(): make_config(env, "laptop").values
        for env in ("ant-flagrun", "ant-gather", "ant-maze", "ant-push")
    }
    rows = [
        (f"`{name}`", *(_shown(values[name]) if name in values else "" for values in columns.values()))
        for name in _HYPERPARAMETERS
    ]
    return table(["setting", *columns], rows)


def _shown(value: Any) -> str:
    """Return a value as it is written on the command line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(map(str, value)) or "none"
    return f"{value:,}" if isinstance(value, int) else str(value)


def public_names() -> str:
    """Return the table of the names that `import shes` offers."""
    rows = []
    for name in shes.__all__:
        value = getattr(shes, name)
        if isinstance(value, str):
            rows.append((f"`shes.{name}`", "The version of the package."))
            continue
        target = f"({name}.md)" if inspect.ismodule(value) else f"[{value.__module__}.{value.__qualname__}]"
        rows.append((f"[`shes.{name}`]{target}", first_paragraph(value)))
    return table(["name", "description"], rows)


def first_paragraph(value: Any) -> str:
    """Return the first paragraph of a docstring on one line."""
    return " ".join(inspect.cleandoc(value.__doc__ or "").partition("\n\n")[0].split())


def deviations() -> str:
    """Return the table of the `Deviation:` passages in all docstrings of the package."""
    package = griffe.load("shes", search_paths=[_SRC])
    rows = [(place, " ".join(text.split())) for place, text in _deviations(package)]
    return table(["where", "deviation"], rows)


def _deviations(item: griffe.Object | griffe.Alias) -> Iterator[tuple[str, str]]:
    """Yield a link to, and the text of, every deviation that `item` and its members state."""
    if item.is_alias:
        return
    place = f"`{item.path}`" if "._" in item.path else f"[`{item.path}`][{item.path}]"
    yield from ((place, text) for text in _DEVIATION.findall(item.docstring.value if item.docstring else ""))
    for member in item.members.values():
        yield from _deviations(member)
