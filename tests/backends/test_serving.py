"""The worker's side of a conversation."""

import pickle

import cloudpickle
import pytest

from shes.backends import serving
from shes.backends.serving import serve


class Echo:
    """A worker that returns each task twice."""

    def receive(self, state):
        pass

    def run(self, work, share):
        while taken := work.take(share):
            yield from ((number, 2 * task) for number, task in taken)


class Parent:
    """A parent that sends these messages, and keeps those that it gets."""

    def __init__(self, *messages):
        self.got = []
        self.recv = iter(messages).__next__

    def send(self, message):
        self.got.append(message)


def test_results_go_with_the_next_message():
    parent = conversation()
    assert parent.got == [
        ("ready",),
        ("want", [], 2, 2),
        ("want", [(0, "aa"), (1, "bb")], 2, 2),
        ("want", [(2, "cc")], 2, 2),
        ("done", []),
    ]


def test_results_that_have_waited_for_long_are_sent_alone(monkeypatch):
    monkeypatch.setattr(serving, "KEPT_S", 0.0)
    kinds = [message[0] for message in conversation().got]
    assert kinds == ["ready", "want", "results", "results", "want", "results", "want", "done"]


def conversation():
    """Return the parent of a worker that has had three tasks."""
    tasks = [("tasks", pickle.dumps(given)) for given in ([(0, "a"), (1, "b")], [(2, "c")])]
    parent = Parent(("run", 2, None), *tasks, ("end",), ("close",))
    serve(parent, pickle.dumps(Echo))
    return parent


@pytest.mark.parametrize("error", [EOFError, BrokenPipeError, ConnectionResetError])
def test_an_error_of_the_work_is_sent_even_if_it_looks_like_a_closed_connection(error):
    class Failing(Echo):
        def run(self, work, share):
            raise error("no more data")

    parent = Parent(("run", 2, None))
    serve(parent, cloudpickle.dumps(Failing))
    (kind, text) = parent.got[-1]
    assert kind == "failed"
    assert f"{error.__name__}: no more data" in text


def test_work_whose_state_has_not_arrived_is_refused():
    parent = Parent(("state", 3, pickle.dumps("state")), ("run", 2, 4))
    serve(parent, pickle.dumps(Echo))
    (kind, error) = parent.got[-1]
    assert kind == "refused"
    assert str(error) == "the work needs state 4, and those that reached this worker are 3"


def test_a_worker_returns_to_the_state_before_the_last_and_keeps_no_more():
    class Stateful(Echo):
        def receive(self, state):
            self.state = state

        def run(self, work, share):
            while taken := work.take(share):
                yield from ((number, f"{task} of {self.state}") for number, task in taken)

    def doing(number, task):
        return ("run", 2, number), ("tasks", pickle.dumps([(0, task)])), ("end",)

    first, second, third = (("state", number, pickle.dumps(f"state {number}")) for number in (3, 4, 5))
    parent = Parent(first, second, *doing(3, "a"), *doing(4, "b"), third, *doing(4, "c"), *doing(3, "d"))
    serve(parent, cloudpickle.dumps(Stateful))
    *others, (kind, error) = parent.got
    results = [content[0] for _, *content in others if content and content[0]]
    assert results == [[(0, "a of state 3")], [(0, "b of state 4")], [(0, "c of state 4")]]
    assert kind == "refused"
    assert str(error) == "the work needs state 3, and those that reached this worker are 4, 5"


@pytest.mark.parametrize("error", [EOFError, BrokenPipeError, ConnectionResetError])
def test_a_parent_that_has_gone_ends_the_worker(error):
    parent = Parent()

    def recv():
        raise error

    parent.recv = recv
    serve(parent, pickle.dumps(Echo))
    assert parent.got == [("ready",)]
