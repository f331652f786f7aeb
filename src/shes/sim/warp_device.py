"""Devices of mujoco-warp: the CPU with NumPy, or a CUDA GPU with CuPy. Arrays are views of Warp's memory."""

# pyright: reportMissingModuleSource=false

from __future__ import annotations

import gc
import os
import warnings
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np

from shes.errors import ConfigError, MissingExtraError, import_extra

DEVICES = ("warp-cpu", "cuda")
_PACKAGES = ("mujoco-warp", "warp-lang")
_OUT_OF_MEMORY = ("failed to allocate", "out of memory", "alloc_failed")  # Warp's, CUDA's, cuBLAS'


def load_warp() -> tuple[ModuleType, ModuleType]:
    """Return the modules `warp` and `mujoco_warp`, initialised.

    Warp's messages on stdout about itself and the kernels that it compiles are turned off, unless the caller has set a
    log level. So is what its native code writes to stderr without a GPU: the error that `WarpDevice` raises says it.
    """
    fix = "Install it: pip install 'shes[gpu]', or 'shes[warp]' for --device warp-cpu alone."
    warp = import_extra("warp", "mujoco-warp cannot be imported", fix)
    if warp.config.log_level == warp.LOG_INFO:
        warp.config.log_level = warp.LOG_WARNING
    mujoco_warp = import_extra("mujoco_warp", "mujoco-warp cannot be imported", fix)
    with Path(os.devnull).open("w") as nowhere, suppress(OSError):  # stderr may be closed
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            warp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
    warp.init()
    return warp, mujoco_warp


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error of Warp, CuPy or NumPy means that memory ran out: by its type, or only by its text."""
    return isinstance(error, MemoryError) or any(text in str(error).lower() for text in _OUT_OF_MEMORY)


class WarpDevice:
    """A device of Warp and the array module for its memory."""

    def __init__(self, name: str) -> None:
        """Open `warp-cpu` or `cuda`.

        On `cuda`, CuPy's current stream in this thread becomes Warp's. The work of both then runs in the order in which
        it was issued, without waiting.
        """
        warp, _ = load_warp()
        self.name = name
        self.xp: ModuleType = np
        if name == "warp-cpu":
            self.warp_device: Any = warp.get_device("cpu")
            return
        if not warp.get_cuda_device_count():
            raise ConfigError(
                "device cuda needs an NVIDIA GPU and its driver, R580 or newer; Warp found none. `nvidia-smi` lists "
                "this machine's GPUs. Use --device cpu."
            )
        self.warp_device = warp.get_device("cuda:0")
        if not warp.is_conditional_graph_supported():
            raise ConfigError(
                "device cuda needs a driver for CUDA 12.4 or newer (conditional graph nodes), got one for CUDA "
                f"{_driver(warp)}. Update the driver, or use --device cpu."
            )
        self.xp = _load_cupy(_driver(warp))
        self.xp.cuda.Device(self.warp_device.ordinal).use()
        with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
            # CuPy 14.2 recommends Stream.from_external, which older versions do not have.
            stream = self.warp_device.stream.cuda_stream
            self._stream = self.xp.cuda.ExternalStream(stream, self.warp_device.ordinal)
        self._stream.use()

    def view(self, array: Any) -> Any:
        """Return a Warp array as an array of `xp` on the same memory."""
        return array.numpy() if self.xp is np else self.xp.asarray(array)

    @property
    def facts(self) -> dict[str, str]:
        """Name, GPU, and the versions that results may depend on: what a run records of its device."""
        facts = {"name": self.name, **{name: metadata.version(name) for name in _PACKAGES}}
        if self.xp is not np:
            warp, _ = load_warp()
            facts |= {"cupy": self.xp.__version__, "card": self.warp_device.name, "driver": f"CUDA {_driver(warp)}"}
        return facts

    def release_memory(self) -> None:
        """Release unused memory: CuPy pools it, and a simulator has reference cycles."""
        gc.collect()
        if self.xp is not np:
            self.xp.get_default_memory_pool().free_all_blocks()

    @contextmanager
    def timed(self, timers: list[Callable[[], float]]) -> Generator[None, None, None]:
        """Append a function to `timers` that returns the seconds of the work in the context, once that is done."""
        if self.xp is np:
            start = perf_counter()
            yield
            seconds = perf_counter() - start
            timers.append(lambda: seconds)
            return
        begin, end = (self.xp.cuda.Event() for _ in range(2))
        begin.record(self._stream)
        yield
        end.record(self._stream)
        timers.append(lambda: (end.synchronize(), self.xp.cuda.get_elapsed_time(begin, end))[1] / 1e3)


def _driver(warp: ModuleType) -> str:
    """Return the newest CUDA version that the driver supports, e.g. `13.0`."""
    return ".".join(map(str, warp.get_cuda_driver_version() or ("none",)))


def _load_cupy(driver: str) -> ModuleType:
    try:
        import cupy

        cupy.zeros(1).sum()  # compiles a kernel, which fails without NVRTC or the headers
    except Exception as error:  # CuPy has an error class for every library
        if "insufficient" in str(error):  # cudaErrorInsufficientDriver
            raise ConfigError(
                f"device cuda needs a newer driver: CuPy says {error}; this one is for CUDA {driver}. Update it to "
                "R580 or newer, or use --device cpu."
            ) from error
        if is_out_of_memory(error):
            raise ConfigError(
                f"the GPU has no free memory ({error}). End what else uses it (`nvidia-smi` lists it), or use --device "
                "cpu."
            ) from error
        raise MissingExtraError(f"device cuda needs CuPy ({error}). Install it: pip install 'shes[gpu]'.") from error
    return cupy
