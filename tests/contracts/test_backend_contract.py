"""What every backend promises. A new backend is one line in `BACKENDS`."""

import psutil
import pytest

from shes.backends.backend import Backend
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.errors import WorkerError
from shes.runs.rooms import WorkerSettings
from shes.settings import setting_fields
from tests.backends.workers import ERRORS, Worker

BACKENDS = {
    "serial": SerialBackend,
    "processes, 1 worker": lambda factory: ProcessesBackend(factory, 1),
    "processes, 3 workers": lambda factory: ProcessesBackend(factory, 3),
}


def test_every_backend_of_the_settings_is_here():
    assert {name.split(",")[0] for name in BACKENDS} == set(setting_fields(WorkerSettings)["backend"].choices)


@pytest.fixture(scope="module", params=BACKENDS)
def shared(request):
    """A backend that one test after another uses: to start one takes longer than most of them."""
    with BACKENDS[request.param](Worker) as made:
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    return shared


@pytest.fixture
def others():
    """Processes that were there before the test."""
    return psutil.Process().children()


@pytest.fixture(params=BACKENDS)
def own_backend(request, others):
    """A backend that no other test uses."""
    with BACKENDS[request.param](Worker) as made:
        made.broadcast(100)
        yield made


def test_a_backend_fulfils_the_contract_class(backend):
    assert isinstance(backend, Backend)
    assert backend.num_workers >= 1
    assert backend.take_events() == []


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


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_of_shes_arrives_as_it_was_raised(backend, name):
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


def test_closing_leaves_no_process_and_may_be_done_twice(own_backend, others):
    list(own_backend.map([("add", 1)] * 4))
    own_backend.close()
    assert psutil.Process().children() == others
    own_backend.close()


def test_closing_at_work_leaves_no_process(own_backend, others):
    results = own_backend.map([("where", 0.05)] * 30)
    next(results)
    own_backend.close()
    assert psutil.Process().children() == others
    results.close()
    assert psutil.Process().children() == others
