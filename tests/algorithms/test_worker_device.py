"""A worker with a device: how many policies at a time, and what happens when its memory or its buffers are too small.

The physics is that of the CPU here; a stand-in says what memory there is.
"""

from types import SimpleNamespace

import pytest

import shes.algorithms.worker
from shes.algorithms.worker import RolloutWorker, lanes_in_memory, simulator_factory
from shes.backends.backend import TaskList
from shes.errors import ConfigError
from shes.hierarchy.rollout import Rollout
from shes.sim.cpu import CpuSimulator
from shes.sim.warp import WarpSimulator
from tests.algorithms.test_worker import _generation, _plan, _run, _work

MEMBERS = 7


def results_of(worker, plan, **changes):
    """Return the returns of a generation by number, and the results themselves."""
    found = _run(worker, _generation(plan, **changes), MEMBERS, MEMBERS)
    return {number: result.returns.tobytes() for number, result in found.items()}, found


@pytest.fixture
def expected():
    plan = _plan()
    return results_of(RolloutWorker(plan), plan)[0]


@pytest.fixture
def device(monkeypatch, expected):
    """A device whose memory has room for `fits` policies at a time; it notes how many were tried."""
    found = SimpleNamespace(fits=100, tried=[], free=None, checked=0)

    class Limited(Rollout):
        def __init__(self, design, make_task, num_lanes, *others):
            found.tried.append(num_lanes)
            if num_lanes > found.fits:
                raise RuntimeError("Failed to allocate 12 bytes on device 'cuda:0'")
            super().__init__(design, make_task, num_lanes, *others)
            self.batch.check_buffers = check

    def check():
        found.checked += 1

    memory = SimpleNamespace(free_bytes=lambda: found.free, release_memory=lambda: None)
    monkeypatch.setattr(shes.algorithms.worker, "Rollout", Limited)
    monkeypatch.setattr(shes.algorithms.worker, "WarpDevice", lambda _: memory)
    monkeypatch.setattr(shes.algorithms.worker, "simulator_factory", lambda *_: CpuSimulator)
    return found


def test_the_cpu_and_a_device_make_their_own_physics():
    assert simulator_factory("cpu", None, None) is CpuSimulator
    factory = simulator_factory("cuda", 3, None)
    assert factory.func is WarpSimulator
    assert factory.keywords == {"device": "cuda", "nconmax": 3, "njmax": None}
    assert _plan(device="warp-cpu", njmax=4).simulator.keywords == {"device": "warp-cpu", "nconmax": None, "njmax": 4}


def test_a_device_runs_the_whole_population_at_once(device, expected):
    plan = _plan(device="cuda", chunk_size=0)
    assert results_of(RolloutWorker(plan), plan)[0] == expected
    assert device.tried == [MEMBERS]


def test_a_chunk_size_splits_it_evenly(device, expected):
    plan = _plan(device="cuda", chunk_size=5)
    assert results_of(RolloutWorker(plan), plan)[0] == expected
    assert device.tried == [4]


def test_buffers_are_checked_after_every_generation(device):
    plan = _plan(device="cuda", chunk_size=0)
    worker = RolloutWorker(plan)
    for generation in (1, 2):
        results_of(worker, plan)
        assert device.checked == generation


def test_an_overflow_ends_the_generation(device):
    plan = _plan()
    worker = RolloutWorker(plan)
    results_of(worker, plan)

    def check():
        raise ConfigError("Set --nconmax to 12.")

    worker._rollouts["training"].batch.check_buffers = check
    with pytest.raises(ConfigError, match="Set --nconmax to 12"):
        results_of(worker, plan)


@pytest.mark.parametrize("chunk_size", [0, 6])
def test_what_does_not_fit_is_split_and_the_log_says_so_once(device, expected, chunk_size):
    device.fits = 2
    plan = _plan(device="cuda", chunk_size=chunk_size)
    worker = RolloutWorker(plan)
    numbers, results = results_of(worker, plan)
    assert numbers == expected
    first = 4 if chunk_size else MEMBERS
    assert device.tried == [first, *([4] if first > 4 else []), 2]
    lines = [line for result in results.values() for line in result.log]
    assert len(lines) == len(device.tried) - 1
    assert lines[-1] == "4 policies at a time are too many for the memory of device cuda: 2 from here on"
    numbers, results = results_of(worker, plan)
    assert numbers == expected
    assert not [line for result in results.values() for line in result.log]
    assert device.tried[-1] == 2
    assert len(device.tried) == len(lines) + 1


def test_memory_that_runs_out_on_the_way_costs_no_result_and_doubles_none(device, expected, monkeypatch):
    plan = _plan(device="cuda", chunk_size=4)
    worker, steps = RolloutWorker(plan), []
    step = Rollout._step

    def limited(self):
        steps.append(self.num_lanes)
        if self.num_lanes == 4 and len(steps) > 8:  # the first four have their results after six
            raise MemoryError("out of memory")
        return step(self)

    monkeypatch.setattr(Rollout, "_step", limited)
    worker.receive(_generation(plan))
    found = list(worker.run(TaskList(_work(MEMBERS)), MEMBERS))
    assert sorted(number for number, _ in found) == list(range(MEMBERS))
    assert {number: result.returns.tobytes() for number, result in found} == expected
    assert device.tried == [4, 2]


def test_no_room_for_one_policy_is_an_error_with_what_helps(device):
    device.fits = 0
    plan = _plan(device="cuda", chunk_size=0)
    message = r"device cuda has too little memory for 2 episodes at a time \(Failed .*--episodes-per-policy"
    with pytest.raises(ConfigError, match=message):
        results_of(RolloutWorker(plan), plan)


@pytest.mark.parametrize(("name", "error"), [("cpu", MemoryError("no")), ("cuda", RuntimeError("something else"))])
def test_other_errors_are_passed_on(device, monkeypatch, name, error):
    def step(self):
        raise error

    monkeypatch.setattr(Rollout, "_step", step)
    plan = _plan(device=name)
    with pytest.raises(type(error), match=str(error)):
        results_of(RolloutWorker(plan), plan)
    assert len(device.tried) == 1


def test_on_a_card_the_memory_that_is_free_says_how_many_there_are_at_a_time(device, expected, monkeypatch):
    plan = _plan(device="cuda", chunk_size=0, nconmax=9)
    measured = []

    def measure(model, *arguments):
        measured.append((model.nq, *arguments))
        return 10_000

    monkeypatch.setattr(shes.algorithms.worker, "bytes_per_sim", measure)
    device.free = 120_000
    worker = RolloutWorker(plan)
    room = lanes_in_memory(device.free, 10_000, plan.design, 2, plan.horizon)
    assert 1 < room < 5
    assert results_of(worker, plan)[0] == expected
    assert device.tried == [-(-MEMBERS // -(-MEMBERS // room))]
    device.free = 0  # taken by what was built: no reason to split further
    assert results_of(worker, plan)[0] == expected
    results_of(worker, plan, is_evaluation=True)
    assert device.tried[1:] == [1]
    assert measured == [(2, "cuda", 5, 9, None)]


def test_parameters_episodes_and_noise_take_memory():
    design = _plan().design

    def room(free=10**9, sim=50_000, episodes=2, horizon=100):
        return lanes_in_memory(free, sim, design, episodes, horizon)

    assert room() == pytest.approx(
        0.75 * 10**9 / (8 * sum(design.dims) + 2 * (50_000 + 8 * (2 * 100 + 2 * 20))), rel=0.01
    )
    assert room(free=2 * 10**9) == pytest.approx(2 * room(), rel=0.01)
    assert room(episodes=4) < room()
    assert room(horizon=1000) < room()
    assert room(sim=10**6) < room()
    assert room(free=0) == 1
