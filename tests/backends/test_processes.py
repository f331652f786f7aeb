"""The processes backend: lost workers are replaced, those that keep dying end the work, and none is left behind."""

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
from tests.backends.workers import Worker, start_dying, start_failing, start_killed, start_refusing
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
    list(shared.map([("add", 1)] * 4))
    shared.told.clear()
    return shared


@pytest.fixture
def others():
    """Processes that were there before the test."""
    return psutil.Process().children()


def test_a_worker_that_dies_is_replaced_and_its_tasks_done_again(backend, tmp_path):
    before = backend.pids()
    tasks = [("add", 1), ("die_once", tmp_path / "marker"), *[("add", i) for i in range(2, 10)]]
    assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    (event,), (dead,) = backend.told, set(before) - set(backend.pids())
    assert re.fullmatch(rf"worker {dead} died \(killed by SIGKILL\); [1-3] tasks are done again", event)
    assert len(set(backend.pids())) == 2


def test_workers_killed_between_maps_are_replaced(backend, tmp_path):
    before = backend.pids()
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    backend.broadcast(200)
    done = list(backend.map([("meet", tmp_path)] * 12))
    assert {state for _, state in done} == {200}
    assert {pid for pid, _ in done} == set(backend.pids())  # each worker is a process of its own
    assert len(set(backend.pids())) == 2
    assert not any(psutil.pid_exists(pid) for pid in before)  # not even zombies


def test_a_task_that_always_kills_its_worker_is_named(backend, tmp_path):
    diary = tmp_path / "diary"
    message = r"\(killed by SIGKILL\) on the same task, \(.*\)\. Usually memory ran out: .*last checkpoint is kept"
    with pytest.raises(WorkerError, match=message) as caught:
        list(backend.map([*[("add", i) for i in range(6)], ("die", diary), ("add", 7)]))
    assert caught.value.task in range(4, 8)  # the poisoned one, or one that went with it
    assert len(diary.read_text().splitlines()) <= MAX_LOSSES
    assert psutil.Process().children() == []
    backend.broadcast(7)
    assert list(backend.map([("add", 1)])) == [8]  # without that task it works again


def test_losses_are_counted_for_each_map_and_leave_no_file_open(backend, tmp_path):
    gc.collect()  # else files that earlier tests left to the collector close during this one
    files = psutil.Process().num_fds()
    for generation in range(MAX_LOSSES + 1):
        tasks = [("die_once", tmp_path / f"{generation}-{i}") for i in range(2)] + [("add", 1)] * 4
        assert list(backend.map(tasks)) == [100, 100] + [101] * 4
    assert len(backend.told) >= MAX_LOSSES + 1
    assert psutil.Process().num_fds() <= files


@pytest.mark.parametrize(
    ("start", "error", "message", "losses"),
    [
        (start_dying, WorkerError, r"keep dying \(exit code 3\) at once\. .*--backend serial does", MAX_LOSSES),
        (start_killed, WorkerError, r"keep dying \(killed by SIGABRT\) at once\. .*--backend serial does", MAX_LOSSES),
        (start_failing, WorkerError, r"(?s)at work on nothing yet.*ValueError: no such model", 0),
        (start_refusing, ConfigError, "sigma must be positive", 0),
    ],
)
def test_workers_that_cannot_start_are_an_error_and_no_loop(others, start, error, message, losses):
    with noted(ProcessesBackend(start, 1)) as backend, pytest.raises(error, match=message) as caught:
        list(backend.map([("add", 1)]))
    assert "memory" not in str(caught.value)
    assert len(backend.told) == losses
    assert psutil.Process().children() == others


def test_errors_of_the_work_name_the_tasks_and_leave_no_process(backend):
    for task, message in {
        ("divide", 0): r"while at work on .*\('divide', 0\).*\n(?s:.*)ZeroDivisionError",
        ("closure", 2): r"(?s)a worker failed.*(pickle|local object)",
        ("closed_pipe", 0): r"(?s)a worker failed.*BrokenPipeError: of its own",
    }.items():
        with pytest.raises(WorkerError, match=message):
            list(backend.map([("add", 1), task]))
        assert psutil.Process().children() == []
    with pytest.raises(Exception, match=r"pickle|local object"):
        list(backend.map([("add", lambda: 1)]))
    assert psutil.Process().children() == []


def test_a_factory_may_be_a_closure_but_needs_to_be_picklable(others):
    with ProcessesBackend(lambda: Worker(at_once=1), 1) as backend:
        backend.broadcast(1)
        assert list(backend.map([("add", 1)] * 3)) == [2, 2, 2]
    lock = threading.Lock()
    message = r"cannot be sent to worker processes: cannot pickle '_thread\.lock' .*or set --backend serial"
    with pytest.raises(ConfigError, match=message):
        ProcessesBackend(lambda: Worker(at_once=lock), 1)
    assert psutil.Process().children() == others


def test_a_class_whose_module_workers_lack_is_named(monkeypatch, tmp_path):
    module = types.ModuleType("found_nowhere")
    module.Mine = type("Mine", (Worker,), {"__module__": "found_nowhere"})
    monkeypatch.setitem(sys.modules, "found_nowhere", module)
    monkeypatch.syspath_prepend(tmp_path)
    message = r"cannot import a module that its work needs: .*found_nowhere.*on PYTHONPATH"
    for _ in ("no such module", "another module of that name"):
        with ProcessesBackend(module.Mine, 1) as backend, pytest.raises(WorkerError, match=message):
            list(backend.map([("add", 1)]))
        (tmp_path / "found_nowhere.py").write_text("")


def test_workers_search_the_first_working_directory_last(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random.py").write_text("raise RuntimeError('not the module of Python')")
    for path, last in ((["", *sys.path], [str(tmp_path)]), (sys.path, [])):
        monkeypatch.setattr(sys, "path", path)
        monkeypatch.chdir(tmp_path)
        with ProcessesBackend(Worker, 1) as backend:
            (seen,) = backend.map([("import_path", None)])
            monkeypatch.chdir("/")
            os.kill(backend.pids()[0], signal.SIGKILL)
            assert list(backend.map([("import_path", None)])) == [seen]
        assert [each for each in seen if each in ("", str(tmp_path))] == seen[len(seen) - len(last) :] == last


def test_workers_ignore_ctrl_c_from_their_first_moment():
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with noted(ProcessesBackend(Worker, 2)) as backend:
        before = backend.pids()
        for _ in range(20):
            for pid in before:
                os.kill(pid, signal.SIGINT)
            time.sleep(0.01)
        backend.broadcast(1)
        assert list(backend.map([("add", 1)] * 9)) == [2] * 9
        assert (backend.told, backend.pids()) == ([], before)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == mask


# Workers that do not answer.


def test_a_stopped_worker_is_reported_and_replaced(tmp_path):
    with noted(ProcessesBackend(Worker, 2, worker_timeout_s=20)) as backend:
        list(backend.map([("where", 0)] * 4))
        backend.worker_timeout_s = 3
        backend.broadcast(100)
        tasks = [("add", 1), ("stop_once", tmp_path / "marker"), *[("add", i) for i in range(2, 10)]]
        assert list(backend.map(tasks)) == [101, 100, *range(102, 110)]
    stopped = int((tmp_path / "marker").read_text())
    assert not psutil.pid_exists(stopped)
    first, last = [event for event in backend.told if event.startswith(f"worker {stopped} ")][-2:]
    assert re.fullmatch(rf"worker {stopped} .* no answer for \d s; it is replaced after 3 s", first)
    assert re.fullmatch(rf"worker {stopped} was ended \(no answer for \d+ s\); [1-3] tasks are done again", last)


def test_a_worker_stopped_between_maps_delays_nothing(tmp_path):
    with ProcessesBackend(Worker, 2) as backend:
        list(backend.map([("meet", tmp_path)] * 4))
        stopped = backend.pids()[0]
        os.kill(stopped, signal.SIGSTOP)
        for state in (b"x" * 10_000_000, 7, 8):  # more than a socket holds
            backend.broadcast(state)
            count = len(list(backend.map([("where", 0)] * 4)))
            assert count == 4
        os.kill(stopped, signal.SIGCONT)
        backend.broadcast(9)
        again = tmp_path / "again"
        again.mkdir()
        done = list(backend.map([("meet", again)] * 12))
        assert {pid for pid, _ in done} == set(backend.pids())
        assert stopped in backend.pids()
        assert {state for _, state in done} == {9}


def test_lost_tasks_do_not_wait_for_a_worker_that_never_asks(tmp_path):
    with noted(ProcessesBackend(Worker, 2)) as backend:
        assert backend.worker_timeout_s == 600
        list(backend.map([("meet", tmp_path)] * 4))
        stopped = backend.pids()[0]
        os.kill(stopped, signal.SIGSTOP)
        backend.broadcast(100)
        # The other one dies with no more in hand than the share of the one that is stopped.
        tasks = [*[("add", i) for i in range(3)], ("die_once", tmp_path / "marker")]
        assert list(backend.map(tasks)) == [100, 101, 102, 100]
        assert stopped in backend.pids()
        assert not any("no answer" in event for event in backend.told)


def test_a_worker_that_dies_at_its_start_is_replaced_later(tmp_path, monkeypatch):
    monkeypatch.setattr("shes.backends.supervision.RESTART_S", 2.0)
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
        list(backend.map([("add", 1)] * 20))
        runs.wait_until(lambda: list(backend.map([("add", 1)])) and len(backend.told) == 2, "it has died")
        assert (len(backend.pids()), len(list(starts.iterdir()))) == (1, 3)
        assert len(list(backend.map([("meet", meeting, 3)] * 4))) == 4  # until a third process has come


def test_a_lost_node_does_not_look_like_workers_that_keep_dying():
    with ProcessesBackend(Worker, 4) as backend:
        backend.broadcast(100)
        backend.num_workers = 1  # what is left of the cluster
        for pid in backend.pids()[:3]:
            os.kill(pid, signal.SIGKILL)
        assert list(backend.map([("add", i) for i in range(6)])) == list(range(100, 106))


def test_progress_keeps_a_slow_task_but_silence_does_not(others, monkeypatch):
    monkeypatch.setattr("shes.backends.supervision.MAX_LOSSES", 2)

    def make():  # in the worker's process
        from shes.backends import serving

        serving.LONGEST_SILENCE_S = 0.1
        return Worker(at_once=1)

    with noted(ProcessesBackend(make, 1)) as backend:
        (pid,) = backend.map([("step", 0)])
        backend.worker_timeout_s = 4
        assert list(backend.map([("step", 6)])) == [pid]
        message = r"keep giving no answer for \d+ s (on the same task, .*|at once)\. .* use --backend serial\."
        with pytest.raises(WorkerError, match=message):
            list(backend.map([("where", 600)]))
    assert psutil.Process().children() == others


# The end of workers.


@pytest.mark.parametrize("moment", ["idle", "at_work", "error"])
def test_workers_are_closed_before_they_end(tmp_path, moment):
    diary, meeting, folder = (tmp_path / name for name in ("diary", "meeting", "at_work"))
    meeting.mkdir()
    folder.mkdir()
    with ProcessesBackend(lambda: Worker(at_once=1, diary=diary), 2) as backend:
        pids = backend.pids()
        list(backend.map([("meet", meeting)] * 4))
        if moment == "at_work":
            results = backend.map([("where", 0), *[("oversleep", folder)] * 3])
            next(results)
            runs.wait_until(lambda: list(folder.iterdir()), "one is at work")
        elif moment == "error":
            with pytest.raises(WorkerError):
                list(backend.map([("divide", 0)]))
    assert sorted(map(int, diary.read_text().split())) == sorted(pids)


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
