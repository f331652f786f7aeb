"""kill -9, inside a generation, of a run and of its workers: no number changes and no process stays."""

import os
import re
import signal

import psutil
import pytest

import shes
from tests.e2e import runs
from tests.e2e.conftest import BRANCHED

pytestmark = pytest.mark.timeout(3600)  # on a machine with a load of 100; what they wait for has its own limit


@pytest.fixture
def imports_no_glfw(monkeypatch):
    """A worker killed while it imports glfw leaves a process behind that says so of its closed pipe on stderr."""
    monkeypatch.setenv("MUJOCO_GL", "off")


def kill(pid):
    os.kill(pid, signal.SIGKILL)


def kill_main_inside(process, path, generation):
    """Kill the run inside `generation` or a later one; return which. No worker outlives it."""
    inside = runs.stop_inside_generation(process, path, generation)
    workers = runs.workers_of(process.pid)
    assert len(workers) == 2
    kill(process.pid)
    assert process.wait() == -signal.SIGKILL
    runs.assert_gone(process.pid, workers)
    assert runs.generation_under_way(path) == inside  # it was inside, by the log, and never came out
    return inside


def kill_worker_inside(process, path, generation, *, stops_others=False):
    """Kill a worker inside `generation` or a later one; return it, the other workers and the generation.

    If the others are stopped, the run cannot end before they go on.
    """
    inside = runs.stop_inside_generation(process, path, generation)
    worker, *others = runs.workers_of(process.pid)
    kill(worker)
    for pid in others if stops_others else ():
        os.kill(pid, signal.SIGSTOP)
    os.kill(process.pid, signal.SIGCONT)
    return worker, others, inside


def losses(path):
    """Return (worker, generation, tasks) of every loss in the log; the generation is None between generations."""
    found, inside = [], None
    for line in runs.log_lines(path):
        if begun := re.fullmatch(r"generation (\d+) begins", line):
            inside = int(begun[1])
        elif re.fullmatch(r"generation \d+ ends", line):
            inside = None
        elif lost := re.fullmatch(r"worker (\d+) died \(killed by SIGKILL\); (\d+) tasks are done again", line):
            found.append((int(lost[1]), inside, int(lost[2])))
    return found


@pytest.mark.parametrize(
    "settings", [pytest.param({}, id="episodes"), pytest.param(BRANCHED, id="branches", marks=pytest.mark.extras)]
)
def test_a_run_killed_inside_a_generation_goes_on_as_before(started, undisturbed_with, settings):
    undisturbed = undisturbed_with(**settings)
    process, path = started(**settings)
    inside = kill_main_inside(process, path, 3)
    assert runs.differences(undisturbed, path)  # something is left to do
    shes.resume(path)
    assert f"begins after generation {inside - 1} with 2 workers" in runs.log_lines(path)[1:]
    assert runs.differences(undisturbed, path) == []


@pytest.mark.usefixtures("imports_no_glfw")
def test_a_worker_killed_inside_a_generation_changes_no_number(started, undisturbed):
    process, path = started()
    worker, others, inside = kill_worker_inside(process, path, 2, stops_others=True)
    workers = runs.wait_until(
        lambda: len(found := set(runs.workers_of(process.pid)) - {worker}) == 2 and found, "there are two workers again"
    )
    assert worker not in [child.pid for child in psutil.Process(process.pid).children()]  # not even as a zombie
    for pid in others:
        os.kill(pid, signal.SIGCONT)
    code, out, err = runs.finish(process)
    assert (code, err) == (0, ""), out
    runs.assert_gone(process.pid, workers)
    ((lost, generation, tasks),) = losses(path)
    # A worker that had just finished its share is missed in the next generation.
    assert (lost, generation - inside) in {(worker, 0), (worker, 1)}
    assert f"worker {worker} died (killed by SIGKILL); {tasks} tasks are done again" in out  # and it is said
    assert runs.differences(undisturbed, path) == []


def test_rows_after_the_last_checkpoint_are_dropped(tmp_path, tiny_run):
    """The tables are written before the checkpoint: a kill between them leaves rows too many, or half a row."""
    path = runs.train_tiny(tmp_path / "run", generations=2)
    for table in (path / "progress.csv", path / "evaluation.csv"):
        columns = table.read_text().partition("\n")[0].split(",")
        with table.open("a") as file:
            file.write(",".join(["3"] + ["1.5"] * (len(columns) - 1)) + "\n")  # a generation after the checkpoint's
            file.write("4,12800,0.")  # half a row
    assert {"progress.csv/generation", "evaluation.csv/generation"} <= runs.numbers(path).keys()
    shes.resume(path, generations=4)
    assert runs.differences(tiny_run, path) == []


@pytest.mark.extras
def test_a_run_killed_in_every_generation_has_the_same_numbers(started, undisturbed):
    process, path = started()
    killed = [kill_main_inside(process, path, 1)]
    while killed[-1] < 4:
        process = runs.start("resume", path)
        try:
            killed.append(kill_main_inside(process, path, killed[-1] + 1))
        finally:
            process.kill()
            process.communicate()
    assert len(killed) > 1
    shes.resume(path)
    assert runs.differences(undisturbed, path) == []


@pytest.mark.extras
@pytest.mark.usefixtures("imports_no_glfw")
def test_workers_killed_in_every_generation_change_no_number(started, undisturbed):
    process, path = started()
    killed, generations = [], set()
    for generation in (1, 1, 2, 2, 3, 3, 4, 4):
        try:
            worker, others, inside = kill_worker_inside(process, path, generation, stops_others=True)
        except runs.EndedTooSoonError:
            assert len(killed) >= 4
            assert len(generations) >= 2
            break
        killed.append(worker)
        generations.add(inside)
        runs.wait_until(lambda worker=worker: not runs.is_alive(worker), "it is gone")
        runs.wait_until(lambda: len(runs.workers_of(process.pid)) == 2, "replaced")
        for pid in others:
            os.kill(pid, signal.SIGCONT)
    code, out, err = runs.finish(process)
    assert (code, err) == (0, ""), out
    found = losses(path)
    assert [worker for worker, _, _ in found] == killed
    # A worker that still starts, or has just finished its share, has no task to lose.
    assert any(tasks > 0 for _, _, tasks in found)
    assert runs.differences(undisturbed, path) == []
