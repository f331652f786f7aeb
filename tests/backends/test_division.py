"""The order in which units of work are handed out: every unit once, in order, and in even shares."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.backends.division import Division, Part
from shes.backends.job import Job
from shes.backends.work import TaskList, TaskSource, num_units
from tests.backends.workers import Letters


class Words(Letters):
    """A divisible task whose result is a text."""

    def join(self, results):
        return "".join(results)


def drain(division, units, enough):
    """Return what workers get that ask in turn, each for `units`."""
    given = []
    while taken := division.take(units, enough):
        given.append(taken)
    return given


@given(
    sizes=st.lists(st.integers(1, 6), max_size=40),
    workers=st.integers(1, 60),
    units=st.integers(1, 20),
    enough=st.integers(1, 20),
)
def test_every_unit_is_given_once_and_in_order(sizes, workers, units, enough):
    given = drain(Division(sizes, workers), units, min(units, enough))
    assert all(sum(part.units for part in taken) <= units for taken in given)
    kept = [(part.task, unit) for taken in given for part in taken for unit in range(part.start, part.stop)]
    assert kept == [(task, unit) for task, size in enumerate(sizes) for unit in range(size)]


@given(policies=st.integers(1, 1000), episodes=st.integers(1, 6), workers=st.integers(1, 1200))
def test_no_worker_gets_more_than_an_even_share(policies, episodes, workers):
    schedule = Division([episodes] * policies, workers)
    share = schedule.share
    assert share == -(-policies * episodes // workers)
    given = drain(schedule, share, share)
    assert len(given) <= workers
    assert [sum(part.units for part in taken) for taken in given[:-1]] == [share] * (len(given) - 1)


def test_a_thousand_policies_of_five_episodes_occupy_six_hundred_workers_as_evenly_as_episodes_can():
    schedule = Division([5] * 1000, 600)
    given = drain(schedule, schedule.share, schedule.share)
    assert Counter(sum(part.units for part in taken) for taken in given) == {9: 555, 5: 1}


def test_the_last_rounds_get_smaller_down_to_what_is_enough():
    schedule = Division([1] * 1000, 2)
    sizes = [len(taken) for taken in drain(schedule, 200, 30)]
    assert sizes[:2] == [200, 200]
    assert sorted(sizes[1:-1], reverse=True) == sizes[1:-1]
    assert sizes[-2] == 30
    assert sum(sizes) == 1000


def test_lost_parts_are_given_again_before_all_others():
    schedule = Division([2, 2, 2], 1)
    first, second = schedule.take(3, 3)
    assert (first, second) == (Part(0, 0, 2), Part(1, 0, 1))
    schedule.give_back([first, second])
    assert schedule.units_left == 6
    assert schedule.take(5, 5) == [first, second, Part(1, 1, 2), Part(2, 0, 1)]


def test_workers_are_wanted_as_long_as_those_expected_leave_some_work():
    schedule = Division([3] * 4, 6)  # shares of 2
    for _ in range(6):
        assert schedule.wants_worker
        schedule.expect()
    assert not schedule.wants_worker
    schedule.meet()  # this one takes less than its share
    schedule.take(1, 1)
    assert schedule.wants_worker


def test_a_job_joins_the_results_of_parts_in_any_order():
    job = Job([Words("abc"), Words("de"), "f"], None, 3)
    given = [*job.give(2, 2), *job.give(2, 2), *job.give(2, 2)]
    assert [getattr(task, "text", task) for _, task in given] == ["ab", "c", "d", "e", "f"]
    for number, task in given[1:]:
        job.add(number, getattr(task, "text", task).upper())
    assert list(job.finished()) == []
    assert not job.is_done
    job.add(given[0][0], "AB")
    assert list(job.finished()) == ["ABC", "DE", "F"]
    assert job.is_done
    assert list(job.finished()) == []


def test_losses_are_counted_for_each_unit_whichever_part_was_lost():
    job = Job([Words("abcd")], None, 1)
    for units in (1, 2, 1):  # a, ab, a
        numbers = [number for number, _ in job.give(units, units)]
        job.take_back(numbers)
    assert job.most_losses(numbers) == (3, 0)
    job = Job([Words("abcd")], None, 1)
    parts = [[number for number, _ in job.give(1, 1)] for _ in "abcd"]
    for numbers in parts:  # four workers of a node that is lost
        job.take_back(numbers)
    assert [job.most_losses(numbers)[0] for numbers in parts] == [1, 1, 1, 1]


@pytest.mark.parametrize(("task", "units"), [(Words("abc"), 3), (("add", 1), 1), ("text", 1)])
def test_a_task_that_is_not_divisible_is_one_unit(task, units):
    assert num_units(task) == units


def test_a_single_worker_takes_whole_tasks():
    tasks = [(number, Words("abc")) for number in range(4)]
    work = TaskList(tasks)
    assert isinstance(work, TaskSource)
    assert [work.take(units) for units in (1, 6, 5)] == [tasks[:1], tasks[1:3], tasks[3:]]
    assert work.take(3) == []
    assert list(TaskList(tasks)) == tasks
