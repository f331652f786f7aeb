"""The device of a run's physics: settings that need one, and its entry in the run's record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.errors import ConfigError
from shes.runs.config import TrainConfig
from shes.sim.warp_device import WarpDevice


def check_asked_device(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect on the device of `config`.

    Other settings of `config` may be left from another device, for a run that returns to it.
    """
    device = config.workers.device
    if device == "cpu":
        for name in ("nconmax", "njmax"):
            if asked.get(name) is not None:
                raise ConfigError(
                    f"{name} is {asked[name]!r}, but the CPU's physics has no fixed buffers. "
                    f"Set --device, or omit --{name}."
                )
        return
    backend, workers = asked.get("backend", "serial"), asked.get("num_workers", 0)
    for name, value, is_idle in (("backend", backend, backend != "serial"), ("num_workers", workers, workers > 1)):
        if is_idle:
            raise ConfigError(
                f"{name} is {value!r}, but one process serves device {device}. "
                f"Omit {config.setting(name).flag}, or set --device cpu."
            )


def device_facts(name: str) -> dict[str, str]:
    """Return the record of device `name`: for a GPU its model and the versions of its software.

    Raises:
        MissingExtraError: The device needs a package that is not installed.
        ConfigError: The machine has no such device, or software versions do not match.
    """
    return {"name": name} if name == "cpu" else WarpDevice(name).facts


def device_changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the differences between the devices of two parts of a run: `device cpu -> cuda`."""
    if before.get("name") != now["name"]:
        return [f"device {before.get('name')} -> {now['name']}"]
    return [f"{key} {before.get(key)} -> {value}" for key, value in now.items() if before.get(key) != value]
