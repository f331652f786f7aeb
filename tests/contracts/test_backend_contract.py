"""The contract of every backend in `shes.backends.registry.BACKENDS`."""

import psutil
import pytest

from shes.backends.backend import Backend
from shes.backends.registry import BACKENDS
from shes.errors import WorkerError
from shes.settings import Execution, setting_fields
from tests.backends.workers import ERRORS, Worker

CASES = [(name, num_workers) for name in BACKENDS for num_workers in (1, 2)]


@pytest.mark.parametrize("name", BACKENDS)
def test_no_option_of_a_backend_changes_numbers(name):
    assert all(option.has(Execution) for option in setting_fields(BACKENDS[name].Options).values())


@pytest.fixture(scope="module", params=CASES, ids=str)
def shared(request):
    """A backend that many tests use: starting one takes longer than most of them."""
    name, num_workers = request.param
    with BACKENDS[name](Worker, num_workers) as made:
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    return shared


@pytest.fixture
def others():
    """Processes that were there before the test."""
    return psutil.Process().children()


@pytest.fixture(params=CASES, ids=str)
def own_backend(request, others):
    """A backend that no other test uses."""
    name, num_workers = request.param
    with BACKENDS[name](Worker, num_workers) as made:
        made.broadcast(100)
        yield made


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
