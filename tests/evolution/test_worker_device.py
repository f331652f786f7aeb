"""A worker with a device: how many policies at a time, and what happens when its memory or its buffers are too small.

The physics is that of the CPU here; a stand-in says what memory there is.
"""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

import shes.rollout.worker
from shes.errors import ConfigError
from shes.rollout.lockstep import Rollout
from shes.rollout.worker import RolloutWorker
from tests.evolution.test_worker import a_plan, returns_of, run
from tests.messages import raises

MEMBERS = 7


def on_device(**changes):
    return RolloutWorker(replace(a_plan(), **{"device": "cuda", "chunk_size": 0, **changes}))


def play(worker, **generation):
    """Return the returns of a generation by number, and what the log says."""
    results = run(worker, MEMBERS, MEMBERS, **generation)
    return returns_of(results), [line for result in results.values() for line in result.log]


@pytest.fixture(scope="module")
def expected():
    return play(RolloutWorker(a_plan()))[0]


@pytest.fixture
def device(monkeypatch):
    """A device with room for `fits` policies at a time, `step` its step; it notes how many were tried."""
    found = SimpleNamespace(fits=100, tried=[], checked=0, overflow=None, step=None)

    class Limited(Rollout):
        def __init__(self, design, make_task, num_lanes, *others):
            found.tried.append(num_lanes)
            if num_lanes > found.fits:
                raise RuntimeError("Failed to allocate 12 bytes on device 'cuda:0'")
            super().__init__(design, make_task, num_lanes, *others)
            self.batch.check_buffers = check
            observe = self.batch.observe
            self.batch.observe = lambda: (found.step and found.step(num_lanes), observe())[1]

    def check():
        found.checked += 1
        if found.overflow:
            raise found.overflow

    memory = SimpleNamespace(release_memory=lambda: None)
    monkeypatch.setattr(shes.rollout.worker, "Rollout", Limited)
    monkeypatch.setattr(shes.rollout.worker, "WarpDevice", lambda _: memory)
    return found


@pytest.mark.parametrize(("chunk_size", "tried"), [(0, MEMBERS), (5, 4)])
def test_a_device_runs_all_at_once_or_in_even_chunks(device, expected, chunk_size, tried):
    """Buffers are checked after every generation; an overflow ends it."""
    worker = on_device(chunk_size=chunk_size)
    for generation in (1, 2):
        assert play(worker) == (expected, [])
        assert device.checked == generation
    assert device.tried == [tried]
    device.overflow = ConfigError("Set --nconmax to 12.")
    with pytest.raises(ConfigError) as caught:
        play(worker)
    assert caught.value is device.overflow


@pytest.mark.parametrize(("chunk_size", "tried"), [(0, [MEMBERS, 4, 2]), (6, [4, 2])])
def test_what_does_not_fit_is_split_and_the_log_says_so_once(device, expected, chunk_size, tried):
    device.fits, worker = 2, on_device(chunk_size=chunk_size)
    numbers, lines = play(worker)
    assert (numbers, device.tried) == (expected, tried)
    assert len(lines) == len(tried) - 1
    assert lines[-1] == "4 policies at a time are too many for the memory of device cuda: 2 from here on"
    assert play(worker) == (expected, [])
    assert device.tried == tried


def test_memory_that_runs_out_on_the_way_costs_no_result(device, expected):
    """Nor does a result come twice: the first four are there after six steps."""
    device.step = Mock(side_effect=[None] * 8 + [MemoryError("out of memory")] + [None] * 99)
    assert play(on_device(chunk_size=4))[0] == expected
    assert device.tried == [4, 2]


def test_no_room_for_one_policy_is_an_error_with_what_helps(device):
    device.fits = 0
    message = "device cuda has too little memory for 2 episodes at a time (Failed ... --episodes-per-policy"
    with raises(ConfigError, message):
        play(on_device())


@pytest.mark.parametrize(("name", "error"), [("cpu", MemoryError("no")), ("cuda", RuntimeError("something else"))])
def test_other_errors_are_passed_on(device, name, error):
    device.step = Mock(side_effect=error)
    with pytest.raises(type(error)) as caught:
        play(on_device(device=name))
    assert caught.value is error
    assert len(device.tried) == 1


def test_training_and_evaluation_take_turns_if_only_one_fits(device, expected):
    """What fits alone is not split, and there is no message."""
    worker = on_device()
    assert play(worker) == (expected, [])
    device.step = Mock(side_effect=[MemoryError("out of memory"), *[None] * 99])
    assert play(worker, kind="evaluation")[1] == []
    device.step = None
    assert play(worker) == (expected, [])
    assert device.tried == [MEMBERS] * 4
