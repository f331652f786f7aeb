"""The rules of supervision, with workers in this process and a clock that runs only while all of them wait."""

import re

import pytest

from shes.backends import supervision
from shes.backends.supervision import MAX_LOSSES, RemoteWorker, SupervisingBackend
from shes.errors import WorkerError
from tests.messages import raises


class Scripted(RemoteWorker):
    """A worker that does a task at once: a number is its own result, a word is what happens to the worker."""

    def __init__(self, backend, name, at_once):
        super().__init__(str(name))
        self.backend, self.at_once, self.least = backend, at_once, at_once
        self.is_gone = self.is_stopped = False
        self.due = []  # (time, request), which the worker sends then
        if name in backend.fail_at_start:
            self.is_gone = True
        else:
            self.send("ready", [])

    def send(self, *request, after_s=0.0):
        self.due.append((self.backend.now_s + after_s, request))

    def answer(self, message, state=None):
        kind, *content = message
        if kind == "run":
            self.send("want", [], self.at_once, self.least)
        elif kind == "tasks":
            self.work(content[0])

    def work(self, numbered):
        self.backend.given.append(len(numbered))
        for number, task in numbered:
            if task == "die" or (task == "die once" and number not in self.backend.tried):
                self.is_gone = True
            elif task == "hang":
                return
            elif isinstance(task, float):  # seconds with signs of life
                for second in range(0, int(task), 10):
                    self.send("results", [], after_s=second)
                self.send("want", [(number, task)], 1, 1, after_s=task)
                return
            self.backend.tried.append(number)
            if self.is_gone:
                return
        self.send(*(("want", numbered, self.at_once, self.least) if numbered else ("ready", [])))

    def requests(self):
        if self.is_gone:
            raise EOFError("of its own will")
        now = [request for due_s, request in self.due if due_s <= self.backend.now_s]
        self.due = [each for each in self.due if each[0] > self.backend.now_s]
        return now

    def has_news(self):
        return not self.is_stopped and (self.is_gone or any(due_s <= self.backend.now_s for due_s, _ in self.due))

    def stop(self):
        pass


class ScriptedBackend(SupervisingBackend):
    def __init__(self, num_workers, *, at_once=1, fail_at_start=()):
        super().__init__(num_workers)
        self.at_once, self.fail_at_start = at_once, fail_at_start
        self.now_s, self.clock = 0.0, lambda: self.now_s
        self.num_started, self.tried, self.given, self.told = 0, [], [], []
        self.on_event = self.told.append
        self.start_workers()

    def start_workers(self):
        while len(self.workers) < self.num_workers:
            self.workers.append(Scripted(self, self.num_started, self.at_once))
            self.num_started += 1

    def wait(self, timeout_s):
        if not any(worker.has_news() for worker in self.workers):
            self.now_s += timeout_s
        return [worker for worker in self.workers if worker.has_news()]


def run(backend, tasks):
    backend.broadcast(1)
    return list(backend.map(tasks))


@pytest.mark.parametrize(("num_workers", "at_once"), [(1, 1), (2, 2), (3, 5)])
def test_lost_tasks_are_done_again_and_results_stay_in_order(num_workers, at_once):
    backend = ScriptedBackend(num_workers, at_once=at_once)
    tasks = [0, 1, "die once", 3, "die once", *range(5, 30)]
    assert run(backend, tasks) == tasks
    assert num_workers > 1 or backend.tried == [0, 1, 2, 2, 3, 4, 4, *range(5, 30)]  # what is lost is given first
    assert len(backend.told) == 2
    assert all(re.fullmatch(r"worker \d died \(of its own will\); [1-5] tasks are done again", each)
               for each in backend.told)  # fmt: skip
    assert (len(backend.workers), backend.num_started) == (num_workers, num_workers + 2)


@pytest.mark.parametrize("num_workers", [1, 3])
@pytest.mark.parametrize(
    ("task", "what", "ending", "advice"),
    [
        ("die", "'die'", "died (of its own will)", "--backend serial does the same work in this process."),
        ("hang", "'hang'", "was ended (no answer for 60 ... s)", "If a step takes so long, use --backend serial."),
    ],
)
def test_a_task_that_no_worker_survives_is_named_briefly(num_workers, task, what, ending, advice):
    backend = ScriptedBackend(num_workers)
    message = f"workers keep dying on task 3 of 9, {what}; the last one {ending}. {advice} Everything up to the last"
    with raises(WorkerError, message):
        run(backend, [0, 1, task, *range(3, 9)])
    assert len(backend.told) >= MAX_LOSSES
    assert backend.workers == []  # nobody needs the remaining results
    backend.start_workers()
    assert run(backend, [7, 8]) == [7, 8]  # without that task it works again


def test_a_long_task_is_cut_in_messages():
    backend = ScriptedBackend(1)
    backend.workers[0].work = lambda _: backend.workers[0].send("failed", None, "Traceback of its own")
    message = r"at work on task 1 of 1, \{'member': 12, 'seeds': .{,40} \.\.\.:\nTraceback of"
    with pytest.raises(WorkerError, match=message):
        run(backend, [{"member": 12, "seeds": tuple(range(10_000))}])


@pytest.mark.parametrize("num_workers", [1, 4])
def test_workers_that_cannot_start_end_the_run(num_workers):
    backend = ScriptedBackend(num_workers, fail_at_start=range(100))
    with raises(WorkerError, "keep dying without a result; the last one died (of its own will). --backend"):
        run(backend, [1])
    assert len(backend.told) == MAX_LOSSES * num_workers


def test_losses_with_a_task_are_counted_for_each_map():
    backend = ScriptedBackend(1)
    for _ in range(MAX_LOSSES + 1):
        backend.tried.clear()
        assert run(backend, ["die once", 1, 2]) == ["die once", 1, 2]


def test_a_lost_node_does_not_look_like_workers_that_keep_dying():
    backend = ScriptedBackend(4)
    run(backend, [0, 1, 2, 3])
    backend.num_workers = 1  # what is left of the cluster
    for worker in backend.workers[:3]:
        worker.is_gone = True
    assert run(backend, [0, 1, 2, 3]) == [0, 1, 2, 3]


def test_one_that_fails_to_start_is_started_again_next_map():
    backend = ScriptedBackend(2, fail_at_start=[2, 3])
    run(backend, [0, 1, 2, 3])
    for started in (3, 4):  # the first one's successor fails, and the next one
        backend.workers[0].is_gone = started == 3
        run(backend, range(9))
        assert (backend.num_started, len(backend.workers)) == (started, 1)
    run(backend, range(9))
    assert (backend.num_started, len(backend.workers)) == (5, 2)


@pytest.mark.parametrize(
    ("limit_s", "reported_s", "end"),
    [(600.0, 60, "replaced after 600 s"), (8.0, 4, "replaced after 8 s"), (None, 60, "never replaced")],
)
def test_a_silent_worker_is_reported_once_and_later_replaced(limit_s, reported_s, end):
    backend = ScriptedBackend(1)
    assert backend.silence_limit_s == 600
    backend.silence_limit_s, backend.workers[0].due = limit_s, [(5000.0, ("ready", []))]
    assert run(backend, [5]) == [5]
    told = [f"worker 0 has given no answer for {reported_s} s; it is {end}"]
    if limit_s is not None:
        told.append(f"worker 0 was ended (no answer for {limit_s:.0f} s); 0 tasks are done again")
    assert backend.told == told


def test_a_slow_task_with_signs_of_life_is_left_alone():
    backend = ScriptedBackend(1)
    assert run(backend, [5000.0]) == [5000.0]
    assert backend.told == []


def test_time_in_which_the_run_was_stopped_does_not_count():
    backend, hours = ScriptedBackend(1), iter(range(1, 10**6, 3600))
    backend.clock = lambda: next(hours)  # as after Ctrl-Z and fg, again and again
    backend.workers[0].due = [(50.0, ("ready", []))]
    assert run(backend, [5]) == [5]
    assert backend.told == []


def test_no_more_workers_are_told_than_there_is_work_for():
    backend = ScriptedBackend(8, at_once=3)
    run(backend, range(64))
    for worker in backend.workers:
        worker.state = None
    assert run(backend, [0, 1]) == [0, 1]
    assert sum(worker.state is not None for worker in backend.workers) == 2


def test_near_the_end_each_worker_gets_fewer_tasks():
    backend = ScriptedBackend(2, at_once=8)
    backend.workers[0].least, backend.workers[1].is_stopped = 2, True
    run(backend, range(40))
    assert backend.given == [8, 8, 6, 5, 4, 3, 2, 2, 2, 0]


@pytest.mark.parametrize("tasks", [[0, 1, 2, 3], [0, 1, 2, "die once"]])
def test_a_worker_stopped_between_maps_delays_nothing(tasks):
    backend = ScriptedBackend(2, at_once=2)
    run(backend, [0, 1, 2, 3])
    backend.tried.clear()
    backend.workers[0].is_stopped = True
    assert run(backend, tasks) == tasks
    assert backend.now_s < supervision.REPORTED_S
