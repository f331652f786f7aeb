"""Where mujoco-warp runs: this machine's CPU with NumPy, or a CUDA card with CuPy; both see Warp's memory itself."""

# pyright: reportMissingModuleSource=false

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from tempfile import TemporaryFile
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np

from shes.errors import ConfigError, MissingExtraError, UnknownNameError

__all__ = ["DEVICES", "WarpDevice", "WarpTimer", "is_out_of_memory", "load_warp"]

DEVICES = ("warp-cpu", "cuda")

_PACKAGES = ("mujoco-warp", "warp-lang")
_NATIVE = "Warp CUDA "  # how lines begin that Warp's native code writes to standard error when it finds no card
_OUT_OF_MEMORY = ("failed to allocate", "out of memory", "alloc_failed")  # Warp's, CUDA's, cuBLAS'


def load_warp() -> tuple[ModuleType, ModuleType]:
    """Return the modules `warp` and `mujoco_warp`, ready.

    Warp announces itself and every kernel that it compiles on stdout; that is turned off unless the caller chose a
    log level. That there is no card, it says on stderr; that is kept for the error of whoever asks for one.

    Raises:
        MissingExtraError: One is not installed.
        ConfigError: Their versions do not go together.
    """
    _check_versions()
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
    _start()
    return warp, mujoco_warp


def _check_versions() -> None:
    """Refuse versions of the packages that physics on a device takes which do not go together.

    Raises:
        ConfigError: mujoco-warp, or this package, needs another version of one.
    """
    from packaging.requirements import Requirement

    for package, extra in (("shes", "warp"), ("mujoco-warp", "")):
        for each in map(Requirement, _found(metadata.requires, package) or ()):
            version = _found(metadata.version, each.name) if each.name in ("mujoco", *_PACKAGES) else None
            is_ours = each.marker is None or each.marker.evaluate({"extra": extra})
            if version is not None and is_ours and not each.specifier.contains(version, prereleases=True):
                raise ConfigError(
                    f"{package} needs {each.name}{each.specifier}, got {version}. Install versions that go together: "
                    "pip install 'shes[gpu]', or 'shes[warp]' for --device warp-cpu alone."
                )


def _found(ask: Callable[[str], Any], package: str) -> Any:
    """Return what `ask` says of `package`; None where it is not installed, which its import says better."""
    try:
        return ask(package)
    except metadata.PackageNotFoundError:
        return None


@cache
def _start() -> str:
    """Initialise Warp, once; return what its native code writes to stderr where it finds no card or an old driver."""
    import warp

    try:
        stderr = os.dup(2)
    except OSError:  # there is none
        warp.init()
        return ""
    with TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            warp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            file.seek(0)
            lines = file.read().decode(errors="replace").splitlines(keepends=True)
            sys.stderr.writelines(line for line in lines if not line.startswith(_NATIVE))
    return " ".join(line.partition(": ")[2].strip() for line in lines if line.startswith(_NATIVE))


def is_out_of_memory(error: BaseException) -> bool:
    """Tell whether an error of Warp, CuPy or NumPy says that memory ran out: each has its own kind, or only a text."""
    return isinstance(error, MemoryError) or any(text in str(error).lower() for text in _OUT_OF_MEMORY)


class WarpTimer:
    """What a device spent on some of its work."""

    measured_s: float = 0.0
    events: tuple[Any, ...] = ()
    elapsed: Callable[[Any, Any], float]

    def seconds(self) -> float:
        """Return the seconds; waits until the work is done."""
        if not self.events:
            return self.measured_s
        self.events[1].synchronize()
        return self.elapsed(*self.events) / 1e3


class WarpDevice:
    """A device of Warp and the array module that looks into its memory."""

    def __init__(self, name: str) -> None:
        """Open `warp-cpu` or `cuda`.

        On `cuda`, CuPy's current stream in this thread becomes Warp's: what either of the two is told to do happens in
        the order in which it was told, without waiting.

        Raises:
            UnknownNameError: There is no such device.
            MissingExtraError: mujoco-warp or CuPy is not installed.
            ConfigError: There is no card, its driver is too old, or versions do not go together.
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
            told = f" ({_start().rstrip('.')})" if _start() else ""
            raise ConfigError(
                f"device cuda needs an NVIDIA card and its driver, R580 or newer; Warp sees none{told}. `nvidia-smi` "
                "shows what this machine has. Use --device cpu."
            )
        self.warp_device = warp.get_device("cuda:0")
        if not warp.is_conditional_graph_supported():
            raise ConfigError(
                "device cuda needs a driver for CUDA 12.4 or newer (conditional graph nodes), got one for CUDA "
                f"{_driver(warp)}. Update the driver, or use --device cpu."
            )
        self.xp = _load_cupy(_driver(warp))
        self.xp.cuda.Device(self.warp_device.ordinal).use()
        self._stream = self.xp.cuda.ExternalStream(self.warp_device.stream.cuda_stream, self.warp_device.ordinal)
        self._stream.use()

    def view(self, array: Any) -> Any:
        """Return a Warp array as one of `xp`, on the same memory."""
        return array.numpy() if self.xp is np else self.xp.asarray(array)

    @property
    def facts(self) -> dict[str, str]:
        """Return what a run writes down of it: its name, the card, and the versions that its numbers may depend on."""
        facts = {"name": self.name, **{name: metadata.version(name) for name in _PACKAGES}}
        if self.xp is not np:
            warp, _ = load_warp()
            facts |= {"cupy": self.xp.__version__, "card": self.warp_device.name, "driver": f"CUDA {_driver(warp)}"}
        return facts

    def free_bytes(self) -> int | None:
        """Return how much memory of the card is free; None on the CPU, whose memory has no such limit."""
        if self.xp is np:
            return None
        self.release_memory()
        self.synchronize()  # Warp's pool gives back what it does not use when it is waited for
        return int(self.xp.cuda.runtime.memGetInfo()[0])

    def release_memory(self) -> None:
        """Give back the memory that nobody uses any more: CuPy keeps it, and a simulator refers to itself."""
        gc.collect()
        if self.xp is not np:
            self.xp.get_default_memory_pool().free_all_blocks()

    @contextmanager
    def timer(self) -> Generator[WarpTimer, None, None]:
        """Measure what the device spends on what it is told meanwhile: ask for it when all is done."""
        timer = WarpTimer()
        if self.xp is np:
            start = perf_counter()
            yield timer
            timer.measured_s = perf_counter() - start
            return
        timer.events = tuple(self.xp.cuda.Event() for _ in range(2))
        timer.events[0].record(self._stream)
        yield timer
        timer.events[1].record(self._stream)
        timer.elapsed = self.xp.cuda.get_elapsed_time

    def synchronize(self) -> None:
        """Wait until everything asked for has happened."""
        if self.xp is not np:
            self._stream.synchronize()


def _driver(warp: ModuleType) -> str:
    """Return the newest CUDA that the driver is for: `13.0`."""
    return ".".join(map(str, warp.get_cuda_driver_version() or ("none",)))


def _load_cupy(driver: str = "none") -> ModuleType:
    """Return the module `cupy`.

    Raises:
        MissingExtraError: It is not installed, or finds no CUDA libraries.
        ConfigError: It is made for a newer driver.
    """
    try:
        import cupy

        cupy.zeros(1).sum()  # a kernel: CuPy misses NVRTC and the headers only when it compiles one
    except Exception as error:  # CuPy has an error of its own for every library that it may miss
        if "insufficient" in str(error):  # cudaErrorInsufficientDriver
            raise ConfigError(
                f"device cuda needs a newer driver: CuPy says {error}; this one is for CUDA {driver}. Update it to "
                "R580 or newer, or use --device cpu."
            ) from error
        raise MissingExtraError(f"device cuda needs CuPy ({error}). Install it: pip install 'shes[gpu]'.") from error
    return cupy
