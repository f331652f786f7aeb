"""kill -9, inside a generation, of a run and of its workers: no number changes and no process stays."""

import os
import re
import signal
from contextlib import suppress

import psutil
import pytest

import shes
from tests.e2e import runs

pytestmark = pytest.mark.timeout(3600)  # on a machine with a load of 100; what they wait for has its own limit


def kill_main_inside(process, path, generation):
    """Kill the run inside `generation` or a later one; return which. No worker outlives it."""
    inside = runs.stop_inside_generation(process, path, generation)
    workers = runs.workers_of(process.pid)
    assert len(workers) == 2
    process.kill()
    assert process.wait() == -signal.SIGKILL
    runs.assert_gone(process.pid, workers)
    assert runs.generation_under_way(path) == inside  # it was inside, by the log, and never came out
    return inside


@pytest.mark.parametrize(
    ("first", "last"), [(3, 3), pytest.param(1, 4, marks=pytest.mark.extras)], ids=["once", "often"]
)
def test_a_run_killed_inside_generations_goes_on_as_before(started, undisturbed, first, last):
    process, path = started()
    killed = [kill_main_inside(process, path, first)]
    while killed[-1] < last:
        process = runs.start("resume", path)
        try:
            killed.append(kill_main_inside(process, path, killed[-1] + 1))
        finally:
            process.kill()
            process.communicate()
    assert runs.differences(undisturbed, path)  # something is left to do
    shes.resume(path)
    assert f"begins after generation {killed[-1] - 1} with 2 workers" in runs.log_lines(path)[1:]
    assert runs.differences(undisturbed, path) == []


def test_rows_after_the_last_checkpoint_are_dropped(tmp_path, tiny_run):
    """The tables are written before the checkpoint: a kill between them leaves rows too many, or half a row."""
    path = runs.train_tiny(tmp_path / "run", generations=2)
    for table in (path / "progress.csv", path / "evaluation.csv"):
        row = ",".join(["3"] + ["1.5"] * table.read_text().partition("\n")[0].count(","))
        table.write_text(f"{table.read_text()}{row}\n4,12800,0.")  # a generation after the checkpoint's, half a row
    shes.resume(path, generations=4)
    assert runs.differences(tiny_run, path) == []


@pytest.mark.parametrize(
    "generations", [(2,), pytest.param((1, 1, 2, 2, 3, 3, 4, 4), marks=pytest.mark.extras)], ids=["once", "often"]
)
def test_workers_killed_inside_generations_change_no_number(started, undisturbed, monkeypatch, generations):
    # A worker killed while it imports glfw leaves a process behind that says so of its closed pipe on stderr.
    monkeypatch.setenv("MUJOCO_GL", "off")
    process, path = started()
    killed = []
    for generation in generations:
        try:
            runs.stop_inside_generation(process, path, generation, os.killpg)
        except runs.EndedTooSoonError:
            break
        worker, *others = runs.workers_of(process.pid)
        os.kill(worker, signal.SIGKILL)
        killed.append(worker)
        os.kill(process.pid, signal.SIGCONT)  # the other one stands, so that the run cannot end before it goes on
        with suppress(AssertionError):  # one that had not begun is replaced with the next generation only
            runs.wait_until(lambda: two_but(killed, process), "there are two workers again", within_s=5.0)
        for pid in others:
            os.kill(pid, signal.SIGCONT)
        workers = runs.wait_until(lambda: two_but(killed, process), "there are two workers again")
        if process.poll() is not None:  # it had every result
            break
        assert worker not in [child.pid for child in psutil.Process(process.pid).children()]  # not even as a zombie
    assert len(killed) >= len(generations) / 2
    code, out, err = runs.finish(process)
    assert (code, err) == (0, ""), out
    runs.assert_gone(process.pid, workers)
    lost = re.compile(r"worker (\d+) died \(killed by SIGKILL\); (\d+) tasks are done again")
    found = [match.groups() for match in map(lost.fullmatch, runs.log_lines(path)) if match]
    assert [int(worker) for worker, _ in found] in (killed, killed[:-1])
    assert len(lost.findall(out)) == len(found)  # and it is said
    assert runs.differences(undisturbed, path) == []


def two_but(killed, process):
    """Return the workers of a run if there are two besides those that were killed, or those if it has ended."""
    found = set(runs.workers_of(process.pid)) - set(killed)
    return found if len(found) == 2 else killed if process.poll() is not None else None
