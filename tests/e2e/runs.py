"""Runs for tests: tiny ones here, others in processes of their own that can be killed; and what their numbers are."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import psutil

from shes.machine import num_cores
from shes.runs.build import open_run
from shes.runs.train import train

TINY = {
    "preset": "smoke",
    "seed": 5,
    "population_size": 8,
    "hidden": (4,),
    "horizon": 20,
    "evaluation_horizon": 20,
    "generations": 4,
    "evaluation_interval": 2,
    "evaluation_episodes": 3,
    "keep_checkpoints": 2,
    "noise_table_size": 1_000_000,
    "backend": "serial",
}
"""Settings of a run that takes a fraction of a second."""

COMMAND = (sys.executable, "-m", "shes")
PATIENCE_S = 60.0
"""Longest wait for something that is about to happen; longer on a busy machine, see `patient`."""


def patient(seconds):
    """Return a limit of `seconds` as it has to be on a machine that is as busy as now: that is no failure."""
    return seconds * max(1.0, os.getloadavg()[0] / num_cores())


def train_tiny(path, env="point-gather", **settings):
    """Train in this process; return the run folder."""
    return train(env, out=path, **{**TINY, **settings}).path


def trained_once(folder, kinds):
    """Return a function that returns the run folder of a kind (environment, settings), trained when first asked for."""

    @cache
    def find(kind):
        env, settings = kinds[kind]
        return train_tiny(folder / kind, env, **settings)

    return find


class AfterGeneration:
    """A listener that calls `action` after generation `number`; 0 is the start."""

    def __init__(self, number, action):
        self.number, self.action = number, action

    def on_start(self, *arguments):
        self.on_generation({"generation": 0})

    def on_generation(self, row):
        if row["generation"] == self.number:
            self.action()


def flags(**settings):
    """Return settings as words of a command line."""
    words = []
    for name, value in settings.items():
        words.append("--" + name.replace("_", "-"))
        words += [str(item) for item in value] if isinstance(value, tuple) else [str(value)]
    return words


def change_json(file, change):
    """Let the function `change` change what a JSON file holds."""
    held = json.loads(file.read_text())
    change(held)
    file.write_text(json.dumps(held))


def state(path, checkpoint="last"):
    """Return the learner's state that a checkpoint holds."""
    return open_run(str(path), str(checkpoint)).state


def numbers(path):
    """Return every array of every checkpoint, and every column of the tables but times and rates, by name."""
    found = {}
    for file in sorted((Path(path) / "checkpoints").glob("*.npz")):  # a killed writer may have left an unfinished file
        with np.load(file) as arrays:
            found |= {f"{file.name}/{name}": arrays[name] for name in arrays.files}
    for table in ("progress.csv", "evaluation.csv"):
        if not (Path(path) / table).exists():  # before the first generation
            continue
        with (Path(path) / table).open(newline="") as file:
            header, *rows = [*csv.reader(file)] or [[]]  # empty if the writer was killed between opening and writing
        for column, name in enumerate(header):
            if not name.endswith("_s"):
                found[f"{table}/{name}"] = np.array([",".join(row[column : column + 1]) for row in rows])
    return found


def differences(first, second):
    """Return the names of the numbers that are not bit-identical in two run folders."""
    one, other = (
        {name: (array.dtype, array.shape, array.tobytes()) for name, array in numbers(path).items()}
        for path in (first, second)
    )
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))


class EndedTooSoonError(AssertionError):
    """A run came to its end before the test could stop it, as may happen on a busy machine."""


def start(*words, command=COMMAND, cwd=None):
    """Start `shes WORDS`, or another command, as the leader of a process group of its own."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*command, *map(str, words)], cwd=cwd, start_new_session=True, **pipes)


def finish(process):
    """Wait for the end of a process; return its exit code and what it printed to stdout and stderr."""
    out, err = process.communicate(timeout=patient(PATIENCE_S))
    return process.returncode, out, err


def run(*words):
    """Run `shes WORDS` to its end; return its exit code and what it printed to stdout and stderr."""
    return finish(start(*words))


def wait_until(condition, what, within_s=PATIENCE_S, every_s=0.002):
    """Return the first true value of `condition()`, which is asked again after `every_s`."""
    start = time.monotonic()
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > start + patient(within_s):
            raise AssertionError(f"not within {patient(within_s):.0f} s: {what}")
        time.sleep(every_s)


def log_lines(path):
    """Return the log of a run without dates, levels and tracebacks; none before it begins."""
    log = Path(path) / "log.txt"
    return re.findall(r"^\d{4}-\S+ \S+ [A-Z]+ (.*)", log.read_text(), re.MULTILINE) if log.exists() else []


def wait_for_generation(process, path, generation):
    """Wait until `generation` has begun, in this run or in an earlier part of it, or the run has ended."""
    text = f"generation {generation} begins"
    wait_until(lambda: text in log_lines(path) or process.poll() is not None, text)


def generation_under_way(path):
    """Return the generation that has begun and not ended, by the log; None between generations."""
    found = [re.fullmatch(r"generation (\d+) (begins|ends)", line) for line in log_lines(path)]
    *_, last = [None, *filter(None, found)]
    return int(last[1]) if last and last[2] == "begins" else None


def stop_inside_generation(process, path, generation, send=os.kill):
    """Stop (SIGSTOP) the run's main process while it is inside `generation` or a later one, and return which.

    With `os.killpg` the workers stop and go on with it.

    The process runs for moments only, from its first generation on: else it ends before a test on a busy machine has
    looked twice. A stopped process writes no log, so what the log says then is where it stands.
    """
    standing = (psutil.STATUS_STOPPED, psutil.STATUS_ZOMBIE)
    wait_for_generation(process, path, 1)
    while True:
        assert not process.poll(), process.communicate()
        if process.poll() == 0:
            raise EndedTooSoonError(log_lines(path))
        send(process.pid, signal.SIGSTOP)
        wait_until(lambda: psutil.Process(process.pid).status() in standing, "the process stops")
        inside = generation_under_way(path)
        if inside is not None and inside >= generation:
            return inside
        send(process.pid, signal.SIGCONT)
        time.sleep(0.02)


def workers_of(pid):
    """Return the process numbers of the living workers whose parent is, or was, process `pid`, oldest first.

    The parent's number is on a worker's command line, so one that lost its parent is found as well. A process that has
    ended and that nobody has asked for yet (a zombie) has no command line any more.
    """
    lines = {process: process.info["cmdline"] or [] for process in psutil.process_iter(["cmdline", "create_time"])}
    found = [each for each, words in lines.items() if "shes.backends.processes" in words and words[-1] == str(pid)]
    return [process.pid for process in sorted(found, key=lambda process: process.info["create_time"])]


def is_alive(pid):
    """Tell whether process `pid` still runs."""
    try:
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False


def assert_gone(main_pid, worker_pids):
    """Fail if a worker of process `main_pid`, one of `worker_pids` or another, is there two seconds from now."""
    assert worker_pids, "no worker was seen: nothing is proved"
    wait_until(
        lambda: not any(is_alive(pid) for pid in worker_pids) and not workers_of(main_pid),
        f"workers {worker_pids} of {main_pid} are gone",
        within_s=2.0,
        every_s=0.02,  # a look at all processes takes several milliseconds
    )
