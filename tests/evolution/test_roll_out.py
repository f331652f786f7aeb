"""The division of tasks between workers: every episode once and in order, in shares as even as they need to be."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.rollout.roll_out import divide
from tests.rollout.made_up import make_task


@given(sizes=st.lists(st.integers(1, 6), max_size=20), num_workers=st.integers(1, 60))
def test_every_episode_is_in_one_part_and_in_order(sizes, num_workers):
    tasks = [make_task(member, range(size)) for member, size in enumerate(sizes)]
    parts = divide(tasks, num_workers)
    kept = [(part.member, slot, seed) for part in parts for slot, seed in zip(part.slots, part.seeds, strict=True)]
    assert kept == [
        (task.member, slot, seed) for task in tasks for slot, seed in zip(task.slots, task.seeds, strict=True)
    ]
    assert all(part.slots for part in parts)


@pytest.mark.parametrize(
    ("num_tasks", "size", "num_workers", "part"),
    [
        (250, 20, 2, 20),
        (250, 20, 240, 5),  # five parts each: whole tasks would be two for some, and leave others idle
        (250, 20, 250, 20),
        (250, 20, 600, 10),
        (1, 20, 2, 10),
        (1, 20, 60, 1),
    ],
)
def test_tasks_are_as_small_as_workers_need_them(num_tasks, size, num_workers, part):
    parts = divide([make_task(member, range(size)) for member in range(num_tasks)], num_workers)
    assert {len(each.slots) for each in parts} == {part}
