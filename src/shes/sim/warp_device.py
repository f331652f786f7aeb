"""Where mujoco-warp runs: this machine's CPU with NumPy, or a CUDA card with CuPy; both see Warp's memory itself."""

# pyright: reportMissingModuleSource=false

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from shes.errors import ConfigError, MissingExtraError, UnknownNameError

__all__ = ["DEVICES", "WarpDevice", "load_warp"]

DEVICES = ("warp-cpu", "cuda")


def load_warp() -> tuple[ModuleType, ModuleType]:
    """Return the modules `warp` and `mujoco_warp`.

    Warp announces itself and every kernel that it compiles on stdout; that is turned off unless the caller chose a
    log level.

    Raises:
        MissingExtraError: One is not installed.
    """
    try:
        import warp

        if warp.config.log_level == warp.LOG_INFO:
            warp.config.log_level = warp.LOG_WARNING
        import mujoco_warp
    except ImportError as error:
        raise MissingExtraError(
            f"mujoco-warp cannot be imported ({error}). Install it: pip install 'shes[gpu]', or 'shes[warp]' for "
            "--device warp-cpu alone."
        ) from error
    return warp, mujoco_warp


class WarpDevice:
    """A device of Warp and the array module that looks into its memory."""

    def __init__(self, name: str) -> None:
        """Open `warp-cpu` or `cuda`.

        On `cuda`, CuPy's current stream in this thread becomes Warp's: what either of the two is told to do happens in
        the order in which it was told, without waiting.

        Raises:
            UnknownNameError: There is no such device.
            MissingExtraError: mujoco-warp or CuPy is not installed.
            ConfigError: There is no card, or its driver is too old.
        """
        if name not in DEVICES:
            raise UnknownNameError("device", name, DEVICES, "Set --device.")
        warp, _ = load_warp()
        self.name = name
        self.xp: ModuleType = np
        if name == "warp-cpu":
            self.warp_device: Any = warp.get_device("cpu")
            return
        if not warp.get_cuda_device_count():
            raise ConfigError(
                "device cuda needs an NVIDIA card and its driver, R580 or newer; Warp sees none. `nvidia-smi` shows "
                "what this machine has. Use --device cpu."
            )
        self.warp_device = warp.get_device("cuda:0")
        if not warp.is_conditional_graph_supported():
            raise ConfigError(
                "device cuda needs a driver for CUDA 12.4 or newer (conditional graph nodes), got CUDA "
                f"{'.'.join(map(str, warp.get_cuda_driver_version()))}. Update the driver, or use --device cpu."
            )
        self.xp = _load_cupy()
        self.xp.cuda.Device(self.warp_device.ordinal).use()
        self._stream = self.xp.cuda.ExternalStream(self.warp_device.stream.cuda_stream, self.warp_device.ordinal)
        self._stream.use()

    def view(self, array: Any) -> Any:
        """Return a Warp array as one of `xp`, on the same memory."""
        return array.numpy() if self.xp is np else self.xp.asarray(array)

    def synchronize(self) -> None:
        """Wait until everything asked for has happened."""
        if self.xp is not np:
            self._stream.synchronize()


def _load_cupy() -> ModuleType:
    """Return the module `cupy`.

    Raises:
        MissingExtraError: It is not installed, or finds no CUDA libraries.
    """
    try:
        import cupy

        cupy.zeros(1).sum()  # a kernel: CuPy misses NVRTC and the headers only when it compiles one
    except Exception as error:  # CuPy has an error of its own for every library that it may miss
        raise MissingExtraError(f"device cuda needs CuPy ({error}). Install it: pip install 'shes[gpu]'.") from error
    return cupy
