"""Tasks and their results: cutting work for workers, and putting results back together."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.level import LevelState
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import EpisodeResults, EpisodeTask, LevelMoments, PopulationResults, spread

SIZES = (2, 4)


def _task(member, seeds, **changes):
    return EpisodeTask(
        **{
            "member": member,
            "noise_index": (member, 2 * member),
            "signs": (1, -1),
            "slots": tuple(range(len(seeds))),
            "seeds": tuple(seeds),
            "records_statistics": member % 2 == 0,
            **changes,
        }
    )


def _population(members, episodes):
    return [_task(m, [1000 * m + e for e in range(episodes)]) for m in range(members)]


def _result(task, seed=0, log=()):
    """Return made-up results that depend on member and slot alone."""
    rows = [np.random.default_rng([seed, task.member, slot]) for slot in task.slots]

    def draw(*shape):
        return np.array([rng.normal(size=shape) for rng in rows])

    moments = tuple(
        LevelMoments(
            count=np.array([int(rng.integers(1, 9)) for rng in rows]), total=draw(size), total_squares=draw(size) ** 2
        )
        for size in SIZES
    )
    return EpisodeResults(
        returns=draw(2).T,
        score=draw(),
        success=draw() > 0,
        steps=np.array([int(rng.integers(1, 500)) for rng in rows]),
        has_terminated=draw() > 0,
        has_diverged=draw() > 0,
        moments=moments if task.records_statistics else None,
        log=log,
    )


@given(members=st.integers(1, 40), episodes=st.integers(1, 6), workers=st.integers(1, 60))
def test_spreading_keeps_every_episode_once_and_in_order(members, episodes, workers):
    tasks = _population(members, episodes)
    cut = spread(tasks, workers)
    kept = [(task.member, slot, seed) for task in cut for slot, seed in zip(task.slots, task.seeds, strict=True)]
    assert kept == [(m, e, 1000 * m + e) for m in range(members) for e in range(episodes)]
    for task in cut:
        whole = tasks[task.member]
        assert (task.noise_index, task.signs) == (whole.noise_index, whole.signs)
        assert task.records_statistics == whole.records_statistics


@given(members=st.integers(1, 40), episodes=st.integers(2, 6), workers=st.integers(1, 60))
def test_only_the_policies_that_do_not_go_around_are_cut(members, episodes, workers):
    cut = spread(_population(members, episodes), workers)
    rounds = members // workers
    assert [len(task.slots) for task in cut] == [episodes] * (rounds * workers) + [1] * (
        (members - rounds * workers) * episodes
    )


def test_one_worker_gets_whole_policies():
    tasks = _population(7, 3)
    assert spread(tasks, 1) == tasks


def test_spreading_leaves_the_callers_list_as_it_was():
    tasks = _population(5, 3)
    spread(tasks, 4)
    assert tasks == _population(5, 3)


def _fill(tasks):
    results = PopulationResults.empty(2, 6, 3)
    for task in tasks:
        results.add(task, _result(task))
    return results


def _bits(results):
    arrays = [
        results.returns,
        results.score,
        results.success,
        results.steps,
        results.has_terminated,
        results.has_diverged,
    ]
    arrays += [a for m in results.moments for a in (m.count, m.total, m.total_squares)]
    return [a.tobytes() for a in arrays]


@pytest.mark.parametrize("workers", [1, 2, 4, 5, 7])
def test_results_are_the_same_whether_a_policy_came_whole_or_by_episodes(workers):
    tasks = _population(6, 3)
    assert _bits(_fill(spread(tasks, workers))) == _bits(_fill(tasks))


def test_results_stand_where_their_member_and_slot_say():
    results = PopulationResults.empty(2, 3, 2)
    task = _task(1, [5, 6], slots=(1, 0))
    result = _result(task)
    results.add(task, result)
    assert results.returns[:, 1].tolist() == result.returns[:, ::-1].tolist()
    assert results.score[1].tolist() == result.score[::-1].tolist()
    assert results.steps[1].tolist() == result.steps[::-1].tolist()
    assert results.success[1].tolist() == result.success[::-1].tolist()
    assert results.has_terminated[1].tolist() == result.has_terminated[::-1].tolist()
    assert results.has_diverged[1].tolist() == result.has_diverged[::-1].tolist()
    assert not results.steps[[0, 2]].any()


def test_fitness_is_the_mean_return_over_episodes_at_each_level():
    results = PopulationResults.empty(2, 2, 2)
    results.returns[:] = [[[1, 3], [0, 0]], [[10, 20], [-1, 2]]]
    assert results.fitness.tolist() == [[2, 0], [15, 0.5]]


def _levels():
    return tuple(
        LevelState(
            theta=np.zeros(1, np.float32),
            optimizer=Adam().start(1),
            statistics=ObservationStatistics.empty(size).merge(2, np.ones(size), np.ones(size)),
        )
        for size in SIZES
    )


def test_statistics_merge_what_was_recorded_and_nothing_else():
    tasks = _population(6, 3)
    results = _fill(tasks)
    recorded = [_result(task).moments for task in tasks if task.records_statistics]
    assert len(recorded) == 3
    for i, level in enumerate(results.merge_statistics(_levels())):
        assert level.statistics.count == 2 + sum(int(m[i].count.sum()) for m in recorded)
        assert level.statistics.total == pytest.approx(1 + sum(m[i].total.sum(axis=0) for m in recorded))
        assert level.statistics.total_squares == pytest.approx(
            1 + sum(m[i].total_squares.sum(axis=0) for m in recorded)
        )


def test_adding_leaves_a_result_as_it_was():
    task = _task(0, [1, 2, 3])
    result = _result(task)
    results = PopulationResults.empty(2, 1, 3)
    results.add(task, result)
    results.add(task, result)
    assert [m.total.tobytes() for m in result.moments] == [m.total.tobytes() for m in _result(task).moments]
    assert [m.count.tolist() for m in result.moments] == [m.count.tolist() for m in _result(task).moments]


def test_without_recorded_observations_the_levels_stay_the_same():
    results = PopulationResults.empty(2, 6, 3)
    task = _task(1, [1, 2, 3])
    results.add(task, _result(task))
    levels = _levels()
    assert results.merge_statistics(levels) is levels


def test_counts_beyond_32_bits_stay_exact():
    results = PopulationResults.empty(2, 2, 3)
    for member in (0, 1):
        task = _task(member, [1, 2, 3], records_statistics=True)
        result = _result(task)
        for m in result.moments:
            m.count[:] = 2**40 + 1
        results.add(task, result)
    counts = [level.statistics.count for level in results.merge_statistics(_levels())]
    assert counts == [6 * (2**40 + 1) + 2] * 2


def test_the_simulators_lines_are_collected():
    results = PopulationResults.empty(2, 2, 3)
    for member, lines in ((0, ("a",)), (1, ()), (1, ("b", "c"))):
        task = _task(member, [1, 2, 3])
        results.add(task, _result(task, log=lines))
    assert results.log == ["a", "b", "c"]
