"""The processes backend with real processes: what they die of, how they end, and that none is left behind.

The rules of supervision are in `test_supervision.py`.
"""

import gc
import os
import re
import signal
import subprocess
import sys
import threading
import time
import types

import psutil
import pytest

from shes.backends.processes import ProcessesBackend
from shes.backends.supervision import MAX_LOSSES
from shes.errors import ConfigError, WorkerError
from tests.backends.workers import Worker, start_dying, start_refusing
from tests.e2e import runs
from tests.messages import raises


def noted(backend):
    """Let `backend` keep its messages in `told`."""
    backend.told = []
    backend.on_event = backend.told.append
    return backend


def pids_of(backend):
    return [int(worker.name) for worker in backend.workers]


@pytest.fixture(scope="module")
def shared():
    """A backend that many tests use: starting one takes longer than most of them."""
    with noted(ProcessesBackend(Worker, 2)) as made:
        yield made


@pytest.fixture
def backend(shared):
    shared.broadcast(100)
    list(shared.map([("add", 1)] * 4))
    shared.told.clear()
    return shared


@pytest.fixture
def others():
    """Processes that were there before the test."""
    return psutil.Process().children()


def test_a_worker_that_dies_is_replaced_and_leaves_nothing(backend, tmp_path):
    gc.collect()  # else files that earlier tests left to the collector close during this one
    before, files = pids_of(backend), psutil.Process().num_fds()
    tasks = [("add", 1), ("die_once", tmp_path / "marker"), *[("add", i) for i in range(2, 10)]]
    assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    (event,), (dead,) = backend.told, set(before) - set(pids_of(backend))
    assert re.fullmatch(rf"worker {dead} died \(killed by SIGKILL\); [1-3] tasks are done again", event)
    assert len(set(pids_of(backend))) == 2
    assert not psutil.pid_exists(dead)  # not even as a zombie
    assert psutil.Process().num_fds() <= files


@pytest.mark.parametrize(
    ("start", "error", "message", "losses"),
    [
        (
            start_dying,
            WorkerError,
            "died (exit code 3). SIGKILL usually ... printed above. --backend serial",
            MAX_LOSSES,
        ),
        (start_refusing, ConfigError, "sigma must be positive", 0),
    ],
)
def test_workers_that_cannot_start_are_an_error_and_no_loop(others, start, error, message, losses):
    with noted(ProcessesBackend(start, 1)) as backend, raises(error, message):
        list(backend.map([("add", 1)]))
    assert len(backend.told) == losses
    assert psutil.Process().children() == others


def test_what_cannot_be_sent_is_an_error_and_leaves_no_process(backend):
    lock = threading.Lock()
    with pytest.raises(WorkerError):
        list(backend.map([("add", 1), ("closure", 2)]))
    with pytest.raises(Exception, match=r"pickle|local object"):
        list(backend.map([("add", lambda: 1)]))
    message = "cannot be sent to worker processes: cannot pickle '_thread.lock' ... or set --backend serial"
    with raises(ConfigError, message):
        ProcessesBackend(lambda: Worker(at_once=lock), 1)
    assert psutil.Process().children() == []


def test_a_class_whose_module_workers_lack_is_named(monkeypatch, tmp_path):
    module = types.ModuleType("found_nowhere")
    module.Mine = type("Mine", (Worker,), {"__module__": "found_nowhere"})
    monkeypatch.setitem(sys.modules, "found_nowhere", module)
    monkeypatch.syspath_prepend(tmp_path)
    message = "cannot import a module that its work needs: ... found_nowhere ... on PYTHONPATH"
    for _ in ("no such module", "another module of that name"):
        with ProcessesBackend(module.Mine, 1) as backend, raises(WorkerError, message):
            list(backend.map([("add", 1)]))
        (tmp_path / "found_nowhere.py").write_text("")


def test_workers_search_the_first_working_directory_last(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random.py").write_text("raise RuntimeError('not the module of Python')")
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    with ProcessesBackend(lambda: Worker(at_once=1), 1) as backend:  # a closure, which cloudpickle sends
        monkeypatch.chdir("/")
        os.kill(pids_of(backend)[0], signal.SIGKILL)
        (seen,) = backend.map([("import_path", None)])  # of a worker that started afterwards
    assert [each for each in seen if each in ("", str(tmp_path))] == seen[-1:] == [str(tmp_path)]


def test_workers_ignore_ctrl_c_from_their_first_moment():
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with noted(ProcessesBackend(Worker, 2)) as backend:
        before = pids_of(backend)
        for _ in range(20):
            for pid in before:
                os.kill(pid, signal.SIGINT)
            time.sleep(0.01)
        assert list(backend.map([("where", 0)] * 2))
        assert (backend.told, pids_of(backend)) == ([], before)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == mask


def test_a_worker_stopped_at_work_is_ended_and_replaced(backend, tmp_path, monkeypatch):
    marker, ticks = tmp_path / "marker", iter(range(10**6))

    def clock():
        """Stand still, but when all wait for the stopped worker alone."""
        at_work = {worker.name for worker in backend.workers if not worker.is_idle}
        clock.now_s = next(ticks) if marker.exists() and at_work == {marker.read_text()} else clock.now_s
        return clock.now_s

    clock.now_s = 0
    monkeypatch.setattr(backend, "clock", clock)
    monkeypatch.setattr(backend, "silence_limit_s", 0.2)
    tasks = [("add", 1), ("stop_once", marker), *[("add", i) for i in range(2, 10)]]
    assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    assert not psutil.pid_exists(int(marker.read_text()))
    assert backend.told[-1].startswith(f"worker {marker.read_text()} was ended (no answer for ")


def test_a_worker_stopped_between_maps_delays_nothing(backend, tmp_path):
    stopped = pids_of(backend)[0]
    os.kill(stopped, signal.SIGSTOP)
    for state in (b"x" * 10_000_000, 7, 8):  # more than a socket holds
        backend.broadcast(state)
        assert len(list(backend.map([("where", 0)] * 4))) == 4
    os.kill(stopped, signal.SIGCONT)
    backend.broadcast(9)
    done = list(backend.map([("meet", tmp_path)] * 12))
    assert {pid for pid, _ in done} == set(pids_of(backend))
    assert stopped in pids_of(backend)
    assert {state for _, state in done} == {9}


@pytest.mark.parametrize("moment", ["at_work", "error"])
def test_workers_are_closed_before_they_end(tmp_path, moment):
    diary, meeting, folder = (tmp_path / name for name in ("diary", "meeting", "at_work"))
    meeting.mkdir()
    folder.mkdir()
    with ProcessesBackend(lambda: Worker(at_once=1, diary=diary), 2) as backend:
        pids = pids_of(backend)
        list(backend.map([("meet", meeting)] * 4))
        if moment == "at_work":
            results = backend.map([("where", 0), *[("oversleep", folder)] * 3])
            next(results)
            runs.wait_until(lambda: list(folder.iterdir()), "one is at work")
            os.kill(pids[0], signal.SIGSTOP)
        else:
            with pytest.raises(WorkerError, match="BrokenPipeError: of its own"):
                list(backend.map([("closed_pipe", 0)]))
    assert sorted(map(int, diary.read_text().split())) == sorted(pids)


PARENT = """
import sys
from shes.backends.processes import ProcessesBackend
from tests.backends.workers import Worker
backend = ProcessesBackend(lambda: Worker(at_once=1), 2)
print(*(worker.name for worker in backend.workers), flush=True)
list(backend.map([("oversleep", sys.argv[1])] * 4))
"""


def test_workers_at_work_do_not_outlive_a_killed_parent(tmp_path):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2
        runs.wait_until(lambda: len(list(tmp_path.iterdir())) == 2, "both are at work")
        assert all(runs.is_alive(pid) for pid in pids)
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()  # workers that were left would keep it open
    runs.assert_gone(parent.pid, pids)
