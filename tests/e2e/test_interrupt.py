"""Ctrl-C and SIGTERM: a checkpoint, how to go on, exit code 130, no process left, the same numbers afterwards."""

import os
import signal
import time
from functools import partial

import pytest

from shes.runs import recorder
from shes.runs.checkpoint import load_checkpoint
from shes.runs.train import resume
from tests.e2e import runs

INTERRUPTED = 130
pytestmark = pytest.mark.timeout(3600)  # on a machine with a load of 100; what they wait for has its own limit


def assert_interrupted(process, path, workers):
    """Fail if the run did not end as Ctrl-C promises."""
    code, out, err = runs.finish(process)
    assert code == INTERRUPTED
    assert f"shes resume {path}" in out
    assert "Interrupted." in err
    assert "Traceback" not in out + err
    runs.assert_gone(process.pid, workers)
    return load_checkpoint(path / "checkpoints" / "last.npz").generation


def go_on(path, undisturbed):
    """Fail if a resumed run has other numbers than one that nothing happened to."""
    resume(path, backend="serial")  # starting workers takes longer than what is left to do
    assert runs.differences(undisturbed, path) == []


def interrupt_inside(process, path, send=os.killpg, number=signal.SIGINT):
    """Send a signal while the run is inside generation 2 or a later one; return that generation and the workers."""
    inside = runs.stop_inside_generation(process, path, 2)
    workers = runs.workers_of(process.pid)
    send(process.pid, number)
    os.kill(process.pid, signal.SIGCONT)
    return inside, workers


@pytest.mark.parametrize(
    ("send", "number"),  # a terminal sends the signal to the whole process group
    [
        (os.killpg, signal.SIGINT),
        pytest.param(os.kill, signal.SIGINT, marks=pytest.mark.extras),
        pytest.param(os.kill, signal.SIGTERM, marks=pytest.mark.extras),
    ],
)
def test_a_run_that_is_interrupted_goes_on_as_before(started, undisturbed, send, number):
    process, path = started()
    inside, workers = interrupt_inside(process, path, send, number)
    assert assert_interrupted(process, path, workers) == inside - 1
    go_on(path, undisturbed)


def test_ctrl_c_while_the_workers_start_is_quiet(started):
    process, path = started(num_workers=3)
    workers = runs.wait_until(lambda: runs.workers_of(process.pid), "the first worker", every_s=0.02)
    os.killpg(process.pid, signal.SIGINT)
    assert assert_interrupted(process, path, workers) == 0


@pytest.mark.extras
@pytest.mark.parametrize("pause_s", [0.0, 0.01, 0.1])
def test_a_second_ctrl_c_ends_at_once_and_harms_nothing(started, undisturbed, pause_s):
    process, path = started()
    _, workers = interrupt_inside(process, path)
    time.sleep(pause_s)
    os.killpg(process.pid, signal.SIGINT)
    code, _, _ = runs.finish(process)
    assert code in (INTERRUPTED, -signal.SIGINT)
    runs.assert_gone(process.pid, workers)
    load_checkpoint(path / "checkpoints" / "last.npz")
    go_on(path, undisturbed)


@pytest.mark.parametrize("place", ["between generations", "while a checkpoint is written"])
def test_a_signal_waits_for_what_is_being_written(tmp_path, tiny_run, monkeypatch, place):
    def save(path, checkpoint):
        if checkpoint.generation == 2 and path.name == "last.npz":
            send()
        return original(path, checkpoint)

    number = signal.SIGINT if place == "between generations" else signal.SIGHUP
    original, send = recorder.save_checkpoint, partial(signal.raise_signal, number)
    listener = runs.AfterGeneration(2, send) if place == "between generations" else None
    if listener is None:
        monkeypatch.setattr(recorder, "save_checkpoint", save)
    before = [signal.getsignal(each) for each in signal.Signals]
    with pytest.raises(KeyboardInterrupt):
        runs.train_tiny(tmp_path / "run", listener=listener)
    assert [signal.getsignal(each) for each in signal.Signals] == before
    assert load_checkpoint(tmp_path / "run" / "checkpoints" / "last.npz").generation == 2
    monkeypatch.undo()
    resume(tmp_path / "run")
    assert runs.differences(tiny_run, tmp_path / "run") == []


def test_a_run_under_nohup_survives_its_terminal(tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    path = runs.train_tiny(tmp_path, listener=runs.AfterGeneration(2, partial(signal.raise_signal, signal.SIGHUP)))
    signal.signal(signal.SIGHUP, before)
    assert load_checkpoint(path / "checkpoints" / "last.npz").generation == 4
