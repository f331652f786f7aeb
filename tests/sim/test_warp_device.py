"""Warp devices with a stand-in for Warp: a GPU, driver or package that is missing or too old is a clear error."""

import os
import sys
import warnings
from importlib import metadata
from types import SimpleNamespace

import numpy as np
import pytest

from shes.errors import ConfigError, MissingExtraError
from shes.sim.warp_device import WarpDevice, is_out_of_memory, load_warp
from tests.messages import raises


@pytest.fixture
def machine(monkeypatch):
    """A machine with a GPU: its Warp and its CuPy."""
    device = SimpleNamespace(name="Card 1", ordinal=0, stream=SimpleNamespace(cuda_stream=7))
    warp = SimpleNamespace(
        config=SimpleNamespace(log_level=20),
        LOG_INFO=20,
        LOG_WARNING=30,
        init=lambda: None,
        get_cuda_device_count=lambda: 1,
        get_cuda_driver_version=lambda: (13, 0),
        is_conditional_graph_supported=lambda: True,
        get_device=lambda _: device,
    )
    stream = SimpleNamespace(use=lambda: None)

    def deprecated(*_):
        warnings.warn("ExternalStream is deprecated", DeprecationWarning, stacklevel=2)  # CuPy 14.2; an error in tests
        return stream

    cupy = SimpleNamespace(
        __version__="14.2.0", zeros=np.zeros, cuda=SimpleNamespace(Device=lambda _: stream, ExternalStream=deprecated)
    )
    monkeypatch.setattr(metadata, "version", {"mujoco-warp": "4.0.1", "warp-lang": "1.20.0"}.get)
    for name, module in (("warp", warp), ("mujoco_warp", SimpleNamespace()), ("cupy", cupy)):
        monkeypatch.setitem(sys.modules, name, module)
    return SimpleNamespace(warp=warp, cupy=cupy)


@pytest.mark.parametrize(
    ("module", "message"),
    [
        ("mujoco_warp", "pip install 'shes[gpu]', or 'shes[warp]' for --device warp-cpu"),
        ("cupy", "device cuda needs CuPy ... pip install 'shes[gpu]'"),
    ],
)
def test_a_missing_extra_is_named(machine, monkeypatch, module, message):
    monkeypatch.setitem(sys.modules, module, None)
    with raises(MissingExtraError, message):
        WarpDevice("cuda")


def test_a_device_records_what_its_results_may_depend_on(machine):
    assert WarpDevice("cuda").facts == {
        "name": "cuda",
        "mujoco-warp": "4.0.1",
        "warp-lang": "1.20.0",
        "cupy": "14.2.0",
        "card": "Card 1",
        "driver": "CUDA 13.0",
    }


def fails(text):
    """Return a function of CuPy that fails with `text`."""

    def zeros(_):
        raise RuntimeError(text)

    return {"zeros": zeros}


OLD_CUPY = "cudaErrorInsufficientDriver: CUDA driver version is insufficient for CUDA runtime version"


@pytest.mark.parametrize(
    ("warp", "cupy", "message"),
    [
        ({"get_cuda_device_count": lambda: 0}, {},
         "needs an NVIDIA GPU ... Warp found none. ... Use --device cpu."),
        ({"is_conditional_graph_supported": lambda: False, "get_cuda_driver_version": lambda: (12, 2)}, {},
         "driver for CUDA 12.4 or newer ... got one for CUDA 12.2. Update the"),
        ({"get_cuda_driver_version": lambda: (12, 8)}, fails(OLD_CUPY),
         "newer driver: CuPy says ... for CUDA 12.8. Update it ... --device cpu"),
        ({}, fails("Out of memory allocating"), "no free memory (Out of memory ... nvidia-smi ... --device cpu."),
    ],
    ids=["no driver", "old driver", "driver older than CuPy", "full GPU"],
)  # fmt: skip
def test_a_card_that_cannot_be_used_is_a_clear_error(machine, warp, cupy, message):
    vars(machine.warp).update(warp)
    vars(machine.cupy).update(cupy)
    with raises(ConfigError, message):
        WarpDevice("cuda")


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError("Unable to allocate 3 GiB"), True),
        (RuntimeError("Failed to allocate 12 bytes on device 'cuda:0'"), True),
        (RuntimeError("Graph launch error: Warp CUDA error 2: out of memory"), True),
        (RuntimeError("CUBLAS_STATUS_ALLOC_FAILED"), True),
        (RuntimeError("CUDA error 700: an illegal memory access was encountered"), False),
    ],
)
def test_an_error_for_lack_of_memory_is_told_from_others(error, expected):
    assert is_out_of_memory(error) is expected


def test_what_warps_native_code_says_without_a_gpu_is_not_shown(machine, capfd):
    warnings_left = [b"Warp CUDA warning: no driver\n"]  # Warp starts once
    machine.warp.init = lambda: warnings_left and os.write(2, warnings_left.pop())
    load_warp()
    os.write(2, b"after\n")
    assert capfd.readouterr() == ("", "after\n")
