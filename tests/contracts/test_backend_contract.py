"""The contract of every backend in `shes.backends.registry.BACKENDS`."""

import importlib.util
import os
import sys
from dataclasses import dataclass
from typing import Annotated

import psutil
import pytest

from shes.backends.backend import Backend
from shes.backends.registry import BACKENDS
from shes.backends.serial import SerialBackend
from shes.errors import ConfigError, WorkerError
from shes.runs.build import build_algorithm, build_backend
from shes.settings import Execution, Settings, setting_fields
from shes.training.make_config import make_config
from tests.backends.clusters import ray_cluster
from tests.backends.workers import ERRORS, Letters, Worker
from tests.e2e import runs

ENGINES = {"ray": "ray", "mpi": "mpi4py"}
"""Packages that backends need. Their workers take seconds to start, so that only pairs are tested."""
CASES = [
    *(
        pytest.param((name, count), id=f"{name}-{count}")
        for name in BACKENDS
        if name not in ENGINES
        for count in (1, 2)
    ),
    *(pytest.param((name, 2), id=name, marks=pytest.mark.extras) for name in ENGINES),
]
SHARED = []
"""Backends that many tests use."""


@pytest.mark.parametrize("name", BACKENDS)
def test_no_option_of_a_backend_changes_numbers(name):
    assert all(option.has(Execution) for option in setting_fields(BACKENDS[name].Options).values())


@dataclass(frozen=True, kw_only=True)
class Loudness(Settings):
    loudness: Annotated[float, Execution()] = 0.5


class Loud(SerialBackend):
    Options = Loudness

    def __init__(self, factory, num_workers, *, loudness):
        super().__init__(factory, num_workers)
        self.loudness = loudness


class Deaf(SerialBackend):
    Options = Loudness

    def __init__(self, factory, num_workers):
        super().__init__(factory, num_workers)


def test_a_backend_is_constructed_with_its_options_as_keyword_arguments(monkeypatch):
    monkeypatch.setattr(BACKENDS, "_entries", dict(BACKENDS))
    BACKENDS.register("loud", Loud)
    config = make_config("point-gather", "smoke", {"backend": "loud", "loudness": 0.75})
    with build_backend(config, build_algorithm(config).plan()) as backend:
        assert backend.loudness == 0.75
    message = r"backend .*Deaf cannot be constructed with 2 arguments and loudness: got an unexpected keyword argument"
    with pytest.raises(ConfigError, match=message):
        BACKENDS.register("deaf", Deaf)


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster with a CPU for every worker of two backends."""
    with ray_cluster(1, num_cpus=2) as started:
        yield started


def prepare(request):
    """Start what the backend of a case needs; skip the test if that is not installed."""
    name, _ = request.param
    if name in ENGINES and importlib.util.find_spec(ENGINES[name]) is None:
        pytest.skip(f"backend {name} needs {ENGINES[name]}")
    if name == "mpi" and "mpi4py.futures" not in sys.modules:
        pytest.skip("tests/backends/test_mpi.py runs these tests under mpiexec")
    if name == "ray":
        request.getfixturevalue("cluster")


@pytest.fixture(scope="module", params=CASES)
def shared(request):
    """A backend that many tests use: starting one takes longer than most of them."""
    prepare(request)
    name, num_workers = request.param
    with BACKENDS[name](Worker, num_workers) as made:
        SHARED.append(made)
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    return shared


@pytest.fixture(params=CASES)
def own_backend(request):
    """A backend that no other test uses, and the children that this process had before."""
    prepare(request)
    for made in SHARED:  # only one backend has the ranks of MPI
        made.close()
    name, num_workers = request.param
    children = psutil.Process().children()
    with BACKENDS[name](Worker, num_workers) as made:
        made.broadcast(100)
        yield made, children


def test_a_backend_fulfils_the_contract_class(backend):
    assert isinstance(backend, Backend)
    assert backend.num_workers >= 1


@pytest.mark.parametrize("count", [1, 2, 4, 20])
def test_results_come_in_the_order_of_the_tasks(backend, count):
    assert list(backend.map([("add", i) for i in range(count)])) == [100 + i for i in range(count)]


def test_no_tasks_have_no_results(backend):
    assert list(backend.map([])) == []
    assert list(backend.map([("add", 1)])) == [101]


def test_tasks_refer_to_the_last_state_broadcast(backend):
    assert list(backend.map([("add", 1)] * 5)) == [101] * 5
    backend.broadcast(200)
    backend.broadcast(300)
    assert list(backend.map([("add", 1)] * 5)) == [301] * 5
    assert list(backend.map([("add", 2)] * 5)) == [302] * 5


def test_a_divisible_task_has_one_result_whoever_does_its_parts(backend):
    found = list(backend.map([Letters("abcdefgh"), ("add", 1), Letters("xyz")]))
    for result, text in ((found[0], "abcdefgh"), (found[2], "xyz")):
        assert "".join(letters.removesuffix("100") for _, letters in result) == text
        assert all(letters.endswith("100") for _, letters in result)
    assert found[1] == 101


def test_work_beside_the_next_map_has_its_own_state_and_both_have_all_results(backend):
    beside = backend.beside([("add", i) for i in range(5)], 1000)
    backend.broadcast(200)
    assert list(backend.map([("add", i) for i in range(7)])) == list(range(200, 207))
    assert beside.is_done
    assert beside.results() == beside.results() == list(range(1000, 1005))


def test_work_beside_that_no_map_follows_is_done_when_its_results_are_asked_for(backend):
    beside = backend.beside([("add", 1), ("add", 2)], 1000)
    assert beside.results() == [1001, 1002]
    backend.broadcast(300)
    assert list(backend.map([("add", 1)])) == [301]


def test_an_error_of_shes_arrives_as_it_was_raised(backend):
    for name in ERRORS if backend.num_workers == 1 else ["name"]:  # after an error, workers start again
        with pytest.raises(type(ERRORS[name])) as raised:
            list(backend.map([("add", 1), ("raises", name), ("add", 2)]))
        assert type(raised.value) is type(ERRORS[name])
        assert str(raised.value) == str(ERRORS[name])
        assert raised.value.exit_code == ERRORS[name].exit_code


def test_any_other_error_is_a_worker_error_with_its_traceback(backend):
    with pytest.raises(WorkerError, match=r"(?s)worker failed.*Traceback.*ZeroDivisionError: division by zero"):
        list(backend.map([("add", 1), ("divide", 0)]))


def test_a_backend_works_again_after_an_error(backend):
    with pytest.raises(WorkerError):
        list(backend.map([("divide", 0)] * 4))
    backend.broadcast(7)
    assert list(backend.map([("add", i) for i in range(6)])) == [7, 8, 9, 10, 11, 12]


def test_a_backend_works_again_after_a_caller_that_stopped_listening(backend):
    results = backend.map([("where", 0.01)] * 20)
    next(results)
    results.close()
    backend.broadcast(7)
    assert list(backend.map([("add", i) for i in range(6)])) == [7, 8, 9, 10, 11, 12]


def test_a_large_state_and_large_results_pass(backend):
    backend.broadcast(b"y" * 5_000_000)
    assert [len(result) for result in backend.map([("repeat", 3_000_000)] * 4)] == [3_000_000] * 4
    assert [len(state) for _, state in backend.map([("where", 0)] * 3)] == [5_000_000] * 3


def test_what_is_given_is_not_changed(backend):
    tasks, state = [("add", [1]), ("add", [2])], [0]
    backend.broadcast(state)
    assert list(backend.map(tasks)) == [[0, 1], [0, 2]]
    assert (tasks, state) == ([("add", [1]), ("add", [2])], [0])


def assert_gone(results, children):
    """Fail if a process that did a ("where", ...) task stays, or this one has other `children`, or zombies."""
    pids = {pid for pid, _ in results} - {os.getpid()}
    if "mpi4py.futures" not in sys.modules:  # a rank stays for further work
        runs.wait_until(lambda: not any(runs.is_alive(pid) for pid in pids), f"workers {pids} are gone", every_s=0.02)
    assert psutil.Process().children() == children


def test_closing_leaves_no_process_and_may_be_done_twice(own_backend):
    backend, children = own_backend
    results = list(backend.map([("where", 0.01)] * 8))
    backend.close()
    assert_gone(results, children)
    backend.close()


def test_closing_at_work_leaves_no_process(own_backend):
    backend, children = own_backend
    results = backend.map([("where", 0.05)] * 30)
    first = [next(results)]
    backend.close()
    assert_gone(first, children)
    results.close()
    assert_gone(first, children)
