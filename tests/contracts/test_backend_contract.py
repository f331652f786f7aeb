"""The contract of every backend in `shes.backends.named_backends.BACKENDS`."""

import importlib.util
import os
import sys
import traceback
from dataclasses import dataclass
from typing import Annotated

import psutil
import pytest
from threadpoolctl import threadpool_limits

from shes.backends.backend import SerialBackend
from shes.backends.named_backends import BACKENDS
from shes.errors import WorkerError
from shes.runs.build import build_algorithm, build_backend
from shes.runs.make_config import make_config
from shes.settings import Execution, Settings, setting_fields
from tests.backends.clusters import ray_cluster
from tests.backends.workers import ERRORS, Worker
from tests.e2e import runs
from tests.messages import raises

ENGINES = {"ray": "ray", "mpi": "mpi4py"}
"""Packages that backends need. Their workers take seconds to start, so that only pairs are tested."""
CASES = [
    pytest.param((name, count), id=f"{name}-{count}", marks=[pytest.mark.extras] if name in ENGINES else [])
    for name in BACKENDS
    for count in (1, 2)
    if name not in ENGINES or count == 2
]
SHARED = []
"""Backends that many tests use."""


@dataclass(frozen=True, kw_only=True)
class Loudness(Settings):
    loudness: Annotated[float, Execution()] = 0.5


class Loud(SerialBackend):
    Options = Loudness

    def __init__(self, factory, num_workers, *, loudness):
        super().__init__(factory, num_workers)
        self.loudness = loudness


def test_options_are_keyword_arguments_and_change_no_number(monkeypatch):
    monkeypatch.setitem(BACKENDS, "loud", Loud)
    assert all(each.has(Execution) for cls in BACKENDS.values() for each in setting_fields(cls.Options).values())
    config = make_config("point-gather", "smoke", {"backend": "loud", "loudness": 0.75})
    with build_backend(config, build_algorithm(config).plan()) as backend:
        assert backend.loudness == 0.75


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster with a CPU for every worker of two backends."""
    with ray_cluster(1, num_cpus=2) as started:
        yield started


def prepare(request):
    """Start what the backend of a case needs; skip the test if that is not installed. Return its class and count."""
    name, count = request.param
    if name in ENGINES and importlib.util.find_spec(ENGINES[name]) is None:
        pytest.skip(f"backend {name} needs {ENGINES[name]}")
    if name == "mpi" and "mpi4py.futures" not in sys.modules:
        pytest.skip("tests/backends/test_mpi.py runs these tests under mpiexec")
    if name == "ray":
        request.getfixturevalue("cluster")
    return BACKENDS[name], count


@pytest.fixture(scope="module", params=CASES)
def shared(request):
    """A backend that many tests use: starting one takes longer than most of them."""
    cls, count = prepare(request)
    with threadpool_limits(2), cls(Worker, count) as made:
        SHARED.append(made)
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    return shared


@pytest.fixture(params=CASES)
def own_backend(request, tmp_path):
    """A backend that no other test uses, the diary of its workers, and the children that this process had before."""
    cls, count = prepare(request)
    for made in SHARED:  # only one backend has the ranks of MPI
        made.close()
    children, diary = psutil.Process().children(), tmp_path / "diary"
    with cls(lambda: Worker(diary=diary), count) as made:
        made.broadcast(100)
        yield made, diary, children


@pytest.mark.parametrize("count", [0, 1, 2, 4, 20])
def test_results_come_in_the_order_of_the_tasks(backend, count):
    for _ in range(2):
        assert list(backend.map([("add", i) for i in range(count)])) == [100 + i for i in range(count)]


def test_linear_algebra_has_one_thread(backend):
    assert list(backend.map([("threads", 0)] * 4)) == [1] * 4


def test_an_error_of_shes_arrives_with_the_line_at_fault(backend):
    for name in ERRORS if backend.num_workers == 1 else ["name"]:  # after an error, workers start again
        with pytest.raises(type(ERRORS[name])) as raised:
            list(backend.map([("add", 1), ("raises", name), ("add", 2)]))
        assert type(raised.value) is type(ERRORS[name])
        assert str(raised.value) == str(ERRORS[name])
        assert raised.value.exit_code == ERRORS[name].exit_code
        assert "raise ERRORS[name]" in "".join(traceback.format_exception(raised.value))


def test_a_backend_works_again_after_an_error_and_a_break(backend):
    message = 'worker failed ... workers.py", line ... , in doubt ... AssertionError'
    with raises(WorkerError, message):
        list(backend.map([("add", 1), ("doubt", 0)]))
    backend.broadcast(6)
    results = backend.map([("where", 0.01)] * 20)
    next(results)
    results.close()  # the caller stops listening
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


@pytest.mark.parametrize("is_at_work", [False, True])
def test_closing_closes_workers_and_leaves_no_process(own_backend, is_at_work):
    backend, diary, children = own_backend
    results = backend.map([("where", 0.01)] * 30)
    done = [next(results)] if is_at_work else list(results)
    backend.close()
    results.close()
    pids = {pid for pid, _ in done}
    if "mpi4py.futures" not in sys.modules:  # a rank stays for further work
        others = pids - {os.getpid()}
        runs.wait_until(lambda: not any(runs.is_alive(pid) for pid in others), f"{others} are gone", every_s=0.02)
    assert psutil.Process().children() == children
    assert pids <= set(map(int, diary.read_text().split()))
    backend.close()
