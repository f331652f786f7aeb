"""Variations of a run: the settings of many runs that differ in the seed and in swept settings."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from shes.errors import ConfigError
from shes.es.noise import NoiseTable
from shes.runs.build import build_algorithm
from shes.runs.config import TrainConfig
from shes.runs.limits import Workload, check_limits
from shes.runs.sections import check_names, known_settings
from shes.settings import Setting, out_of_range
from shes.training.make_config import make_config

_MOST_RUNS = 1_000
_ELSEWHERE = {"seed": "Give several seeds by --seed 1 2 3.", "env": "Runs of a folder have one environment."}


def read_sweep(texts: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the values of each swept setting, with their texts as keys, from `name=value,value`.

    Numbers of a tuple are joined by x: `hidden=64x64,32`.

    Raises:
        ConfigError: A text has another form, a setting cannot be swept or is named twice, or a value is not allowed.
    """
    known = {each.flag.lstrip("-").replace("-", "_"): each for each in known_settings().values()}
    known |= known_settings()
    sweep: dict[str, dict[str, Any]] = {}
    for text in texts:
        name, equals, values = text.partition("=")
        name = name.strip().lstrip("-").replace("-", "_")
        if not equals or not name:
            raise ConfigError(f"a sweep must be a setting and its values, got {text!r}. Set --sweep sigma=0.02,0.05.")
        if name in _ELSEWHERE:
            raise ConfigError(f"{name} cannot be swept. {_ELSEWHERE[name]}")
        if name not in known:
            check_names({"env": "ant-gather", name: values})  # raises with the nearest name
            raise ConfigError(f"unknown setting {name!r} in --sweep.")
        setting = known[name]
        if setting.name in sweep:
            raise ConfigError(f"{setting.name} is swept twice. Give all its values at once: {name}=A,B,C.")
        found = {each.strip(): _value(setting, each.strip()) for each in values.split(",")}
        if len(found) < values.count(",") + 1 or len(set(found.values())) < len(found):
            raise ConfigError(f"--sweep {text} has a value twice. Remove it.")
        sweep[setting.name] = found
    return sweep


def _value(setting: Setting, text: str) -> Any:
    """Return the value of a setting written as `text`; raise ConfigError or UnknownNameError if it is not allowed."""
    if setting.is_optional and text.lower() == "none":
        return None
    reads = {int: int, float: float, bool: {"true": True, "false": False}.__getitem__}
    read = reads.get(setting.item, str)
    try:
        if setting.kind is tuple:
            return setting.checked(tuple(read(word) for word in text.split("x")) if text != "none" else ())
        return setting.checked(read(text))
    except (KeyError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise out_of_range(setting.name, text, setting.allowed, f"--sweep {setting.name}=...") from error


def vary(
    env: str,
    preset: str,
    settings: Mapping[str, Any],
    seeds: Sequence[int],
    sweep: Mapping[str, Mapping[str, Any]],
) -> dict[str, TrainConfig]:
    """Return the settings of a run for every seed and every combination of swept values.

    The keys are the places of the runs in their folder: `seed-1`, or `sigma-0.02_hidden-64/seed-1`.

    Raises:
        ConfigError: A setting is not allowed or is both given and swept, or there is no seed or one twice.
        UnknownNameError: A name is unknown.
    """
    for name in sweep:
        if name in settings:
            raise ConfigError(f"{name} is both given and swept. Omit one.")
    if not seeds:
        raise ConfigError("seed needs at least one value. Set --seed 1 2 3, or omit it.")
    for seed in seeds:
        if seeds.count(seed) > 1:
            raise ConfigError(f"seed {seed} is given twice: it would be the same run. Set --seed.")
    count = math.prod((len(seeds), *map(len, sweep.values())))
    if count > _MOST_RUNS:
        raise ConfigError(f"these are {count:,} runs; at most {_MOST_RUNS:,} are allowed. Sweep fewer values.")
    found: dict[str, TrainConfig] = {}
    for texts in itertools.product(*sweep.values()):
        values = {name: sweep[name][text] for name, text in zip(sweep, texts, strict=True)}
        group = "_".join(
            _file_name(f"{name.replace('_', '-')}-{text}") for name, text in zip(sweep, texts, strict=True)
        )
        while group and f"{group}/seed-{seeds[0]}" in found:  # the file names of two values may be equal
            group += "-"
        for seed in seeds:
            asked = {**settings, **values, "seed": seed}
            config = make_config(env, asked.pop("preset", preset), asked)
            if seed == seeds[0]:
                # All that can be refused is refused before the first run.
                algorithm = build_algorithm(config)
                check_limits(Workload.of(config), algorithm.design)
                if "noise_table_size" in config.values:
                    NoiseTable.check_room(config.values["noise_table_size"])
            found[f"{group}/seed-{seed}" if group else f"seed-{seed}"] = config
    return found


def _file_name(text: str) -> str:
    """Return `text` with all characters that may be special in a file name or a shell replaced."""
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", text)[:80]
