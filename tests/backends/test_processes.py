"""The processes backend: workers that die are replaced, those that keep dying end the work, and none is left behind."""

import gc
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from multiprocessing.connection import Connection

import psutil
import pytest

from shes.backends.process import SocketWorker
from shes.backends.processes import ProcessesBackend
from shes.backends.pull import MAX_LOSSES
from shes.errors import ConfigError, WorkerError
from tests.backends.workers import Worker, start_dying, start_failing, start_refusing, start_sigterm
from tests.e2e import runs


def noted(backend):
    """Let `backend` keep its messages in `told`."""
    backend.told = []
    backend.on_event = backend.told.append
    return backend


@pytest.fixture(scope="module")
def shared():
    """A backend that many tests use: starting one takes longer than most of them."""
    with noted(ProcessesBackend(Worker, 2)) as made:
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    shared.told.clear()
    return shared


@pytest.fixture
def others():
    """Processes that were there before the test."""
    return psutil.Process().children()


@pytest.fixture
def max_losses(monkeypatch):
    """A limit of losses that is reached sooner."""
    monkeypatch.setattr("shes.backends.pull.MAX_LOSSES", 2)
    return 2


def test_every_worker_is_a_process_of_its_own_and_has_the_state(backend, tmp_path):
    done = list(backend.map([("meet", tmp_path)] * 12))
    assert {pid for pid, _ in done} == set(backend.pids())
    assert len(set(backend.pids())) == 2
    assert {state for _, state in done} == {100}


def test_a_worker_has_one_thread_whatever_the_parent_has(monkeypatch):
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    for variable in variables:
        monkeypatch.setenv(variable, "8")
    with ProcessesBackend(Worker, 1) as backend:
        assert list(backend.map([("environment", variable) for variable in variables])) == ["1"] * 3


def test_a_worker_that_dies_at_work_is_replaced_and_its_tasks_are_done_again(backend, tmp_path):
    before = backend.pids()
    tasks = [("add", 1), ("die_once", tmp_path / "marker"), *[("add", i) for i in range(2, 10)]]
    assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    (event,) = backend.told
    (dead,) = set(before) - set(backend.pids())
    assert event.startswith(f"worker {dead} died (exit code -9); ")
    assert int(event.partition("; ")[2].split()[0]) >= 1
    assert event.endswith("tasks are done again")
    assert len(set(backend.pids())) == 2


def test_workers_killed_between_two_maps_are_replaced_and_get_the_state(backend):
    list(backend.map([("add", 1)] * 4))
    before = backend.pids()
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    assert list(backend.map([("add", i) for i in range(8)])) == list(range(100, 108))
    assert sorted(backend.told) == sorted(f"worker {pid} died (exit code -9); 0 tasks are done again" for pid in before)
    assert not set(before) & set(backend.pids())
    assert not any(psutil.pid_exists(pid) for pid in before)  # not even zombies


def test_a_worker_killed_before_a_broadcast_is_replaced_and_gets_the_new_state(backend, tmp_path):
    list(backend.map([("add", 1)] * 4))
    os.kill(backend.pids()[0], signal.SIGKILL)
    backend.broadcast(200)
    done = list(backend.map([("meet", tmp_path)] * 12))
    assert {state for _, state in done} == {200}
    assert {pid for pid, _ in done} == set(backend.pids())


def test_a_task_that_always_kills_its_worker_is_an_error_that_names_the_fix(backend, tmp_path):
    diary = tmp_path / "diary"
    message = (
        rf"workers keep dying \(killed by SIGKILL, exit code -9\) on the same task, {MAX_LOSSES} times\. "
        r"Usually memory ran out: lower --workers or --chunk-size\. Everything up to the last checkpoint is kept"
    )
    with pytest.raises(WorkerError, match=message):
        list(backend.map([*[("add", i) for i in range(6)], ("die", diary), ("add", 7)]))
    assert len(diary.read_text().splitlines()) <= MAX_LOSSES
    assert len(backend.told) == MAX_LOSSES
    assert psutil.Process().children() == []
    backend.broadcast(7)
    assert list(backend.map([("add", 1)])) == [8]  # without that task it works again


def test_losses_are_counted_for_each_map_and_task(backend, tmp_path):
    for generation in range(MAX_LOSSES + 1):
        tasks = [("die_once", tmp_path / f"{generation}-{i}") for i in range(2)] + [("add", 1)] * 4
        assert list(backend.map(tasks)) == [100, 100] + [101] * 4
    assert len(backend.told) >= MAX_LOSSES + 1


@pytest.mark.parametrize(
    ("start", "num_workers", "cause"),
    [(start_dying, 2, "exit code 3"), (start_sigterm, 1, "killed by SIGTERM, exit code -15")],
)
def test_workers_that_die_at_once_are_an_error_that_names_the_cause_and_no_endless_loop(
    others, max_losses, start, num_workers, cause
):
    message = rf"workers keep dying \({cause}\) at once\. .*--backend serial does the same work in this process\. Every"
    with noted(ProcessesBackend(start, num_workers)) as backend, pytest.raises(WorkerError, match=message) as caught:
        list(backend.map([("add", 1)]))
    assert "memory" not in str(caught.value)
    assert len(backend.told) == num_workers * max_losses
    assert psutil.Process().children() == others


def test_a_worker_that_cannot_be_made_is_an_error_with_its_traceback(others):
    with ProcessesBackend(start_failing, 2) as backend, pytest.raises(WorkerError, match="ValueError: no such model"):
        list(backend.map([("add", 1)]))
    with ProcessesBackend(start_refusing, 1) as backend, pytest.raises(ConfigError, match="sigma must be positive"):
        list(backend.map([("add", 1)]))
    assert psutil.Process().children() == others


def test_a_worker_error_names_the_tasks_at_work(backend):
    with pytest.raises(WorkerError, match=r"while at work on .*\('divide', 0\).*\n(?s:.*)ZeroDivisionError"):
        list(backend.map([("divide", 0)]))


def test_a_result_that_cannot_be_pickled_is_a_worker_error(backend):
    with pytest.raises(WorkerError, match=r"(?s)a worker failed.*(pickle|local object)"):
        list(backend.map([("add", 1), ("closure", 2)]))
    assert psutil.Process().children() == []


def test_a_task_that_cannot_be_pickled_leaves_no_process(backend):
    with pytest.raises(Exception, match=r"pickle|local object"):
        list(backend.map([("add", lambda: 1)]))
    assert psutil.Process().children() == []
    backend.broadcast(7)
    assert list(backend.map([("add", 1)])) == [8]


def test_a_factory_may_be_a_closure():
    with ProcessesBackend(lambda: Worker(at_once=1), 1) as backend:
        backend.broadcast(1)
        assert list(backend.map([("add", 1)] * 3)) == [2, 2, 2]


def test_a_factory_that_cannot_be_pickled_is_an_error_that_names_the_reason(others):
    lock = threading.Lock()
    message = (
        r"cannot be sent to worker processes: cannot pickle '_thread\.lock' object\. Move .*or set --backend serial"
    )
    with pytest.raises(ConfigError, match=message):
        ProcessesBackend(lambda: Worker(at_once=lock), 1)
    assert psutil.Process().children() == others


@pytest.mark.parametrize("is_there", [False, True], ids=["no such module", "another module of that name"])
def test_a_class_whose_module_workers_do_not_find_is_an_error_that_names_it(monkeypatch, tmp_path, is_there):
    module = types.ModuleType("found_nowhere")
    module.Mine = type("Mine", (Worker,), {"__module__": "found_nowhere"})
    monkeypatch.setitem(sys.modules, "found_nowhere", module)
    monkeypatch.syspath_prepend(tmp_path)
    if is_there:
        (tmp_path / "found_nowhere.py").write_text("")
    with (
        ProcessesBackend(module.Mine, 1) as backend,
        pytest.raises(WorkerError, match=r"cannot import a module that its work needs: .*found_nowhere.*on PYTHONPATH"),
    ):
        list(backend.map([("add", 1)]))


def test_a_worker_searches_the_working_directory_if_the_parent_does_and_last_of_all(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random.py").write_text("raise RuntimeError('not the module of Python')")
    for path, last in ((["", *sys.path], str(tmp_path)), (sys.path, None)):
        monkeypatch.setattr(sys, "path", path)
        with ProcessesBackend(Worker, 1) as backend:
            (seen,) = backend.map([("import_path", None)])
        assert (str(tmp_path) in seen, seen[-1] == last) == (last is not None, last is not None)
        assert "" not in seen


def test_workers_that_replace_others_search_where_the_first_did(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    with ProcessesBackend(Worker, 1) as backend:
        (before,) = backend.map([("import_path", None)])
        monkeypatch.chdir(tmp_path)
        os.kill(backend.pids()[0], signal.SIGKILL)
        assert list(backend.map([("import_path", None)])) == [before]


def test_workers_ignore_ctrl_c_from_their_first_moment():
    with noted(ProcessesBackend(Worker, 2)) as backend:
        before = backend.pids()
        for _ in range(20):
            for pid in before:
                os.kill(pid, signal.SIGINT)
            time.sleep(0.01)
        backend.broadcast(1)
        assert list(backend.map([("add", 1)] * 9)) == [2] * 9
        assert (backend.told, backend.pids()) == ([], before)


def test_starting_workers_leaves_the_signal_mask_as_it_was():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with ProcessesBackend(Worker, 1):
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def test_a_stopped_worker_is_told_of_and_replaced_and_its_tasks_are_done_again(tmp_path):
    told = []
    with ProcessesBackend(Worker, 2, worker_warning_s=0.5, worker_timeout_s=3) as backend:
        backend.on_event = told.append
        backend.broadcast(100)
        tasks = [("add", 1), ("stop_once", tmp_path / "marker"), *[("add", i) for i in range(2, 10)]]
        assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    stopped = int((tmp_path / "marker").read_text())
    assert not psutil.pid_exists(stopped)
    *_, first, last = [event for event in told if event.startswith(f"worker {stopped} ")]
    assert re.fullmatch(
        rf"worker {stopped} has given no answer for \d s; it is replaced after \d+ s \(--worker-timeout-s\)", first
    )
    assert re.fullmatch(rf"worker {stopped} was ended \(no answer for \d+ s\); [1-3] tasks are done again", last)


def test_a_worker_that_is_stopped_between_two_maps_delays_nothing_and_works_again_when_it_goes_on(tmp_path):
    with ProcessesBackend(Worker, 2, worker_timeout_s=600) as backend:
        list(backend.map([("where", 0)] * 4))
        stopped = backend.pids()[0]
        os.kill(stopped, signal.SIGSTOP)
        for state in (b"x" * 10_000_000, 7, 8):  # more than a pipe holds
            backend.broadcast(state)
            if state in (7, 8):
                assert list(backend.map([("add", i) for i in range(4)])) == [state + i for i in range(4)]
        os.kill(stopped, signal.SIGCONT)
        backend.broadcast(9)
        done = list(backend.map([("meet", tmp_path)] * 12))
        assert {pid for pid, _ in done} == set(backend.pids())
        assert stopped in backend.pids()
        assert {state for _, state in done} == {9}


def test_a_worker_that_is_stopped_after_it_asked_for_tasks_too_late_delays_nothing(tmp_path):
    class Deaf(ProcessesBackend):
        unheard = None

        def ready_workers(self, timeout_s):
            return [worker for worker in super().ready_workers(timeout_s) if worker is not self.unheard]

    with Deaf(Worker, 2, worker_timeout_s=600) as backend:
        list(backend.map([("meet", tmp_path)] * 4))  # both are ready
        late = backend.unheard = backend.workers[0]
        backend.broadcast(7)
        assert list(backend.map([("add", i) for i in range(4)])) == [7, 8, 9, 10]
        assert late.connection.poll(60)  # its question, which the next `map` answers
        os.kill(late.popen.pid, signal.SIGSTOP)
        backend.unheard = None
        for state in (8, 9):
            backend.broadcast(state)
            assert list(backend.map([("add", i) for i in range(4)])) == [state + i for i in range(4)]
        os.kill(late.popen.pid, signal.SIGCONT)
        again = tmp_path / "again"
        again.mkdir()
        assert {pid for pid, _ in backend.map([("meet", again)] * 4)} == set(backend.pids())


def test_work_that_is_lost_does_not_wait_for_a_worker_that_never_asks(tmp_path):
    with noted(ProcessesBackend(Worker, 2, worker_timeout_s=5)) as backend:
        list(backend.map([("meet", tmp_path)] * 4))
        stopped = backend.pids()[0]
        os.kill(stopped, signal.SIGSTOP)
        backend.broadcast(100)
        # The other one dies with no more in hand than the share of the one that is stopped.
        tasks = [*[("add", i) for i in range(3)], ("die_once", tmp_path / "marker")]
        assert list(backend.map(tasks)) == [100, 101, 102, 100]
        assert stopped in backend.pids()
        assert not any("no answer" in event for event in backend.told)
        os.kill(stopped, signal.SIGCONT)


def test_a_worker_that_dies_at_its_start_beside_others_is_replaced_after_a_while(tmp_path):
    starts, meeting = tmp_path / "starts", tmp_path / "meeting"
    starts.mkdir()
    meeting.mkdir()

    def make():
        number = len(list(starts.iterdir()))
        (starts / str(os.getpid())).touch()
        if number == 2:
            os._exit(3)
        return Worker()

    with noted(ProcessesBackend(make, 2)) as backend:
        backend.broadcast(100)
        list(backend.map([("meet", meeting)] * 4))
        os.kill(backend.pids()[0], signal.SIGKILL)
        assert list(backend.map([("add", i) for i in range(20)])) == list(range(100, 120))
        assert len(list(backend.map([("meet", meeting, 3)] * 4))) == 4  # until a third process has come
        assert len(backend.told) == 2
    *_, third, fourth = sorted(each.stat().st_mtime for each in starts.iterdir())
    assert fourth - third >= 1.5


def test_a_worker_that_was_ended_while_its_message_waited_is_not_asked_for_it(monkeypatch):
    with noted(ProcessesBackend(Worker, 1)) as backend:
        backend.broadcast(100)
        (pid,) = backend.pids()
        wait = backend.ready_workers

        def find_the_dead_twice(timeout_s):
            found = list(wait(timeout_s))
            return [*found, *[worker for worker in found if worker.popen.pid == pid]]

        list(backend.map([("add", 1)]))
        monkeypatch.setattr(backend, "ready_workers", find_the_dead_twice)
        os.kill(pid, signal.SIGKILL)
        assert list(backend.map([("add", i) for i in range(3)])) == [100, 101, 102]
        assert len(backend.told) == 1


def test_a_worker_that_has_not_started_is_sent_no_state_but_that_of_its_work():
    with noted(ProcessesBackend(Worker, 1)) as backend:
        (worker,) = backend.workers
        worker.is_started = False
        for state in (1, 2, 3):
            backend.broadcast(state)
        assert worker.states == ()
        worker.is_started = True
        assert list(backend.map([("add", 0)])) == [3]
        assert len(worker.states) == 1


def test_a_worker_keeps_the_state_of_the_generation_while_it_does_work_beside_it(monkeypatch):
    with noted(ProcessesBackend(Worker, 1)) as backend:
        sent, send_state = [], backend.send_state
        monkeypatch.setattr(
            backend, "send_state", lambda worker, state: (sent.append(state.number), send_state(worker, state))
        )
        for generation in (100, 200, 300):
            backend.broadcast(generation)
            beside = backend.beside([("add", i) for i in range(4)], generation - 1)
            assert list(backend.map([("add", i) for i in range(4)])) == [generation + i for i in range(4)]
            assert beside.results() == [generation - 1 + i for i in range(4)]
        assert len(sent) == len(set(sent)) == 6


def test_a_node_that_is_lost_does_not_look_like_workers_that_keep_dying():
    with ProcessesBackend(Worker, 4) as backend:
        backend.broadcast(100)
        backend.num_workers = 1  # what is left of the cluster
        for pid in backend.pids()[:3]:
            os.kill(pid, signal.SIGKILL)
        assert list(backend.map([("add", i) for i in range(6)])) == list(range(100, 106))


def test_a_worker_that_is_stopped_while_it_sends_a_result_is_replaced(monkeypatch):
    with ProcessesBackend(lambda: Worker(at_once=1), 1, worker_timeout_s=1) as backend:
        (process,) = backend.workers
        pid = process.popen.pid

        def wait_and_stop(timeout_s):
            """Stop the worker when it has begun to send its first result, which is larger than what a pipe holds."""
            ready = wait(timeout_s)
            if ready and process.numbers and runs.is_alive(pid):
                os.kill(pid, signal.SIGSTOP)
                runs.wait_until(lambda: psutil.Process(pid).status() == psutil.STATUS_STOPPED, "it is stopped")
            return ready

        wait = backend.ready_workers
        monkeypatch.setattr(backend, "ready_workers", wait_and_stop)
        assert [len(result) for result in backend.map([("repeat", 10_000_000)] * 2)] == [10_000_000] * 2
        assert pid not in backend.pids()


def test_a_worker_that_goes_on_is_told_of_and_loses_no_work():
    with noted(ProcessesBackend(Worker, 1, worker_warning_s=0.2, worker_timeout_s=60)) as backend:
        (pid,) = backend.pids()
        assert list(backend.map([("where", 1.0)])) == [(pid, None)]
        *_, last = backend.told
        assert re.fullmatch(rf"worker {pid} answers again, after \d+ s", last)


def test_a_task_that_takes_longer_than_the_limit_gets_more_time_when_it_is_done_again():
    with ProcessesBackend(Worker, 2, worker_timeout_s=1) as backend:
        before = backend.pids()
        assert [state for _, state in backend.map([("where", 2.0)])] == [None]
        assert backend.pids() != before
        after = backend.pids()
        assert [state for _, state in backend.map([("where", 2.0)])] == [None]  # now it is known to take so long
        assert backend.pids() == after


def test_a_task_that_is_never_answered_is_an_error_that_names_the_flag(tmp_path, others, max_losses):
    many = r"(on the same task, \d times|at once)"  # on a busy machine even the start takes longer than this limit
    message = rf"workers keep giving no answer for \d+ s {many}\. .* raise --worker-timeout-s\. Every"
    with ProcessesBackend(Worker, 1, worker_timeout_s=0.3) as backend, pytest.raises(WorkerError, match=message):
        list(backend.map([("oversleep", tmp_path)]))
    assert psutil.Process().children() == others


def test_replacing_workers_leaves_no_open_file(backend, tmp_path):
    list(backend.map([("add", 1)] * 4))
    gc.collect()  # else files that earlier tests left to the collector close during this one
    before = psutil.Process().num_fds()
    for i in range(3):
        list(backend.map([("die_once", tmp_path / str(i)), ("add", 1)]))
    assert psutil.Process().num_fds() <= before


PARENT = """
import sys, time
from shes.backends.processes import ProcessesBackend
from tests.backends.workers import Worker

backend = ProcessesBackend(lambda: Worker(at_once=1), 2)
print(*backend.pids(), flush=True)
if sys.argv[1] == "at_work":
    list(backend.map([("oversleep", sys.argv[2])] * 4))
time.sleep(600)
"""


@pytest.mark.parametrize("moment", ["starting", "at_work"])
def test_workers_do_not_outlive_a_killed_parent(moment, tmp_path):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, moment, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2
        if moment == "at_work":
            runs.wait_until(lambda: len(list(tmp_path.iterdir())) == 2, "both are at work")
        assert all(runs.is_alive(pid) for pid in pids)
    finally:
        parent.kill()
        parent.communicate()
    runs.assert_gone(parent.pid, pids)


def test_workers_that_die_beside_other_work_are_replaced_with_the_right_state(backend, tmp_path):
    beside = backend.beside([("die_once", tmp_path / "marker"), *[("add", i) for i in range(6)]], 1000)
    assert list(backend.map([("add", i) for i in range(20)])) == list(range(100, 120))
    assert beside.results() == [1000, *range(1000, 1006)]
    assert len(backend.told) == 1


def test_work_beside_that_failed_is_not_done(backend):
    beside = backend.beside([("add", 1), ("divide", 0)], 1000)
    with pytest.raises(WorkerError, match="division by zero"):
        list(backend.map([("add", 1)] * 4))
    assert not beside.is_done
    with pytest.raises(WorkerError, match="this work ended with an error"):
        beside.results()


def test_messages_to_a_worker_that_does_not_read_wait_in_order():
    own, theirs = socket.socketpair()
    worker = SocketWorker(own, b"factory", None)
    sent = [bytes([i % 256]) * (1_000_000 if i % 50 == 7 else 2_000) for i in range(300)]
    for message in sent:  # much more than the socket takes: small ones at once, then all by the thread
        worker.send_pickled(message)
    with Connection(theirs.detach()) as connection:
        assert [connection.recv_bytes() for _ in range(301)] == [b"factory", *sent]
        worker.send_pickled(b"at once again")
        assert connection.recv_bytes() == b"at once again"
        worker.end()
        with pytest.raises(EOFError):
            connection.recv_bytes()
