"""A worker's side of the conversation, with a parent and a clock in this process."""

import pickle

import pytest

from shes.backends.serving import LONGEST_SILENCE_S, RESULTS_WAIT_S, ClosedError, ParentConnection, serve
from tests.backends.workers import ERRORS

LONG_S = LONGEST_SILENCE_S / 2


class Parent(ParentConnection):
    """A parent that has some tasks, each for itself, and then closes the connection."""

    def __init__(self, tasks):
        self.tasks, self.now_s, self.heard, self.has_left = list(enumerate(tasks)), 0.0, [], False

    def tell(self, *request):
        self.heard.append(request)

    def receive(self):
        kind, *_ = self.heard[-1]
        if kind == "ready" and not self.tasks:
            raise ClosedError
        if kind == "ready":
            return ("run", 3), pickle.dumps(100)
        return ("tasks", [self.tasks.pop(0)] if self.tasks else []), None

    def leave(self):
        self.has_left = True


class Worker:
    """Takes some time for each task, or raises; `parent` is set by the test."""

    parent = None
    is_closed = False

    def receive(self, state):
        self.state = state

    def run(self, tasks, share):
        while taken := tasks.take(share, share):
            for number, task in taken:
                if isinstance(task, str):
                    raise ERRORS[task] if task in ERRORS else OSError(lambda: 0)
                for seconds in task:
                    Worker.parent.now_s += seconds
                    tasks.note_progress()
                yield number, self.state + number

    def close(self):
        Worker.is_closed = True


@pytest.fixture
def heard(monkeypatch):
    """Return a function that serves tasks and returns the worker's requests."""
    monkeypatch.setattr(Worker, "is_closed", False)

    def run(*tasks):
        parent = Parent(tasks)
        monkeypatch.setattr(Worker, "parent", parent)
        serve(parent, pickle.dumps(Worker), lambda: parent.now_s)
        assert Worker.is_closed
        assert parent.has_left
        return parent.heard

    return run


def test_results_come_with_the_next_request(heard):
    assert heard([RESULTS_WAIT_S / 2], []) == [
        ("ready", []),
        ("want", [], 3, 3),
        ("want", [(0, 100)], 3, 3),
        ("want", [(1, 101)], 3, 3),
        ("ready", []),
    ]


@pytest.mark.parametrize(
    ("seconds", "requests"),
    [
        ([LONG_S], [[(0, 100)]]),
        ([LONG_S] * 4, [[], []]),
        ([LONG_S] * 5, [[], [], [(0, 100)]]),
    ],
)
def test_a_slow_worker_sends_results_or_a_sign_of_life(heard, seconds, requests):
    assert [results for kind, results, *_ in heard(seconds) if kind == "results"] == requests


def test_errors_are_pickled_if_they_are_ours(heard):
    *_, (kind, error, text) = heard([], "config")
    assert (kind, error) == ("failed", pickle.dumps(ERRORS["config"]))
    assert "raise ERRORS[task]" in text
    *_, (kind, error, text) = heard([], "other")
    assert (kind, error) == ("failed", None)
    assert "OSError: <function" in text
