"""Where a run's physics is computed: what goes with a device, whether there is one, and what the record says of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.errors import ConfigError
from shes.runs.config import TrainConfig
from shes.sim.warp_device import WarpDevice

__all__ = ["check_asked_device", "device_changes", "device_facts"]


def check_asked_device(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Refuse settings among the `asked` ones that do nothing on the device of `config`.

    The same settings may stay from a time on another device: a run that goes on there has its workers, or its buffers,
    back when it returns.

    Raises:
        ConfigError: There is one.
    """
    device = config.workers.device
    if device == "cpu":
        for name in ("nconmax", "njmax"):
            if asked.get(name) is not None:
                raise ConfigError(
                    f"{name} is {asked[name]!r}, but the CPU's physics has no fixed buffers. "
                    f"Set --device, or leave --{name} away."
                )
        return
    backend, workers = asked.get("backend", "serial"), asked.get("num_workers", 0)
    if backend != "serial":
        raise ConfigError(
            f"backend is {backend!r}, but one process serves device {device}. "
            "Leave --backend away, or set --device cpu."
        )
    if workers > 1:
        raise ConfigError(
            f"num_workers is {workers}, but one process serves device {device}. "
            "Leave --workers away, or set --device cpu."
        )


def device_facts(name: str) -> dict[str, str]:
    """Return what a run writes down of device `name`: the card, and versions, where it is not the CPU.

    Raises:
        MissingExtraError: The device needs a package that is not installed.
        ConfigError: There is no such device in this machine, or versions do not go together.
    """
    return {"name": name} if name == "cpu" else WarpDevice(name).facts


def device_changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return what differs between the devices of two parts of a run: `device cpu -> cuda`."""
    if before.get("name") != now["name"]:
        return [f"device {before.get('name')} -> {now['name']}"]
    return [f"{key} {before.get(key)} -> {value}" for key, value in now.items() if before.get(key) != value]
