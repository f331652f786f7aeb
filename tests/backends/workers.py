"""A worker for the tests of backends, which does what a task says. Worker processes import this module."""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from shes.errors import ConfigError, PolicyError, ShapeError, UnknownNameError

ERRORS = {
    "config": ConfigError("sigma must be positive, got -1. Set --sigma."),
    "name": UnknownNameError("reward", "progres", ["progress", "cosine"], "Set --primitive-reward."),
    "policy": PolicyError("the policy of member 3 returned NaN."),
    "shape": ShapeError("got (3,)."),
}
"""Errors that a task may ask for."""


class Worker:
    """Runs tasks (verb, argument), a few at a time, and yields their results last first.

    If it has a diary, it writes there that it is closed.
    """

    def __init__(self, at_once=3, diary=None):
        self.at_once, self.diary = at_once, diary
        self.state = None

    def receive(self, state):
        self.state = state

    def run(self, tasks, share):
        while taken := tasks.take(most := min(self.at_once, share), most):
            for number, task in reversed(taken):
                yield number, self.do(*task)

    def close(self):
        if self.diary is not None:
            with Path(self.diary).open("a") as file:
                file.write(f"{os.getpid()}\n")

    def do(self, verb, argument=None, *more):
        return getattr(self, verb)(argument, *more)

    def add(self, number):
        """Add the state to a number."""
        return self.state + number

    def where(self, seconds):
        """Take some time; return the process and the state."""
        time.sleep(seconds)
        return os.getpid(), self.state

    def node(self, seconds):
        """Take some time; return the name of the node of a test's cluster, and the state."""
        time.sleep(seconds)
        return os.environ.get("SHES_TEST_NODE"), self.state

    def meet(self, folder, count=2):
        """Wait until `count` processes do this task; return the process and the state."""
        (Path(folder) / str(os.getpid())).touch()
        while len(list(Path(folder).iterdir())) < count:
            time.sleep(0.01)
        return os.getpid(), self.state

    def stop_once(self, marker):
        """Write the number of this process and stop it (SIGSTOP) the first time; return the state the next time."""
        if not Path(marker).exists():
            Path(marker).write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGSTOP)
        return self.state

    def oversleep(self, folder):
        """Leave a file named after this process in `folder`, then take ten minutes, in which it notices nothing."""
        (Path(folder) / str(os.getpid())).touch()
        time.sleep(600)

    def threads(self, _):
        """Return the number of threads of linear algebra."""
        np.ones((2, 2)) @ np.ones((2, 2))
        return max(pool["num_threads"] for pool in threadpool_info())

    def raises(self, name):
        raise ERRORS[name]

    def doubt(self, _):
        assert self is None

    def import_path(self, _):
        return sys.path

    def closed_pipe(self, _):
        raise BrokenPipeError("of its own")

    def closure(self, value):
        """Return what cannot be pickled."""
        return lambda: value

    def repeat(self, size):
        return b"x" * size

    def die_once(self, marker):
        """Kill this process the first time; return the state the next time."""
        if not Path(marker).exists():
            Path(marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.state


def start_refusing():
    """Stand for a worker that refuses its settings."""
    raise ERRORS["config"]


def start_dying():
    """Stand for a worker whose process dies before it can do anything."""
    os._exit(3)
