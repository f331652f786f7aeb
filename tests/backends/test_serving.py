"""Signs of life of a worker, with a parent and a clock in this process."""

import pickle

import pytest

from shes.backends.serving import LONGEST_SILENCE_S, RESULTS_WAIT_S, ClosedError, ParentConnection, serve

LONG_S = LONGEST_SILENCE_S / 2


class Parent(ParentConnection):
    """A parent with a single task, a list of times, which then closes the connection."""

    now_s = 0.0

    def __init__(self, task):
        self.tasks, self.heard = [(0, task)], []

    def tell(self, *request):
        self.heard.append(request)

    def receive(self):
        if self.heard[-1][0] != "ready":
            return ("tasks", [self.tasks.pop()] if self.tasks else []), None
        if not self.tasks:
            raise ClosedError
        return ("run", 3), pickle.dumps(100)


class Worker:
    """Takes some time for each part of a task."""

    def receive(self, state):
        self.state = state

    def run(self, tasks, share):
        while taken := tasks.take(share, share):
            for number, task in taken:
                for seconds in task:
                    Parent.now_s += seconds
                    tasks.note_progress()
                yield number, self.state + number

    def close(self):
        pass


@pytest.mark.parametrize(
    ("seconds", "requests"),
    [
        ([], [("want", [(0, 100)], 3, 3)]),
        ([RESULTS_WAIT_S / 2], [("want", [(0, 100)], 3, 3)]),
        ([LONG_S], [("results", [(0, 100)]), ("want", [], 3, 3)]),
        ([LONG_S] * 4, [("results", [])] * 2 + [("want", [(0, 100)], 3, 3)]),
        ([LONG_S] * 5, [("results", [])] * 2 + [("results", [(0, 100)]), ("want", [], 3, 3)]),
    ],
)
def test_a_slow_worker_sends_results_or_a_sign_of_life(seconds, requests):
    """Otherwise results come with the next request."""
    parent = Parent(seconds)
    serve(parent, pickle.dumps(Worker), lambda: Parent.now_s)
    assert parent.heard == [("ready", []), ("want", [], 3, 3), *requests, ("ready", [])]
