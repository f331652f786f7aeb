"""Cutting work for workers: every episode once, in order."""

from hypothesis import given
from hypothesis import strategies as st

from shes.hierarchy.episodes import spread
from tests.hierarchy.made_up import population


@given(members=st.integers(1, 40), episodes=st.integers(1, 6), workers=st.integers(1, 60))
def test_spreading_keeps_every_episode_once_and_in_order(members, episodes, workers):
    tasks = population(members, episodes)
    cut = spread(tasks, workers)
    kept = [(task.member, slot, seed) for task in cut for slot, seed in zip(task.slots, task.seeds, strict=True)]
    assert kept == [(m, e, 1000 * m + e) for m in range(members) for e in range(episodes)]
    for task in cut:
        whole = tasks[task.member]
        assert (task.noise_index, task.signs) == (whole.noise_index, whole.signs)
        assert task.records_statistics == whole.records_statistics


@given(members=st.integers(1, 40), episodes=st.integers(2, 6), workers=st.integers(1, 60))
def test_only_the_policies_that_do_not_go_around_are_cut(members, episodes, workers):
    cut = spread(population(members, episodes), workers)
    rounds = members // workers
    assert [len(task.slots) for task in cut] == [episodes] * (rounds * workers) + [1] * (
        (members - rounds * workers) * episodes
    )


def test_one_worker_gets_whole_policies():
    tasks = population(7, 3)
    assert spread(tasks, 1) == tasks


def test_spreading_leaves_the_callers_list_as_it_was():
    tasks = population(5, 3)
    spread(tasks, 4)
    assert tasks == population(5, 3)
