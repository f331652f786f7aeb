"""What came of a population: results put together, whichever way the work was cut."""

import numpy as np
import pytest

from shes.es.level import LevelState
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from shes.hierarchy.episodes import PARTS
from shes.hierarchy.results import PopulationResults, lower_diverged
from tests.hierarchy.made_up import SIZES, make_result, make_task, population

BY_EPISODE = (
    "score", "success", "steps", "has_terminated", "has_fallen", "has_diverged", "goals_reached", "final_position",
    "environment_returns",
)  # fmt: skip
"""What there is of every episode [n, E, ...], beside the returns [L, n, E]."""


def _fill(tasks):
    results = PopulationResults.empty(2, 6, 3)
    for task in tasks:
        results.add(task, make_result(task))
    return results


def _bits(results):
    arrays = [results.returns, *(getattr(results, name) for name in BY_EPISODE)]
    arrays += [a for m in results.moments for a in (m.count, m.total, m.total_squares)]
    return [a.tobytes() for a in arrays]


def _singles(tasks):
    """Return the episodes of `tasks` as tasks of their own."""
    return [task.part(i, i + 1) for task in tasks for i in range(len(task.slots))]


def test_results_are_the_same_whether_a_policy_came_whole_or_by_episodes():
    tasks = population(6, 3)
    assert _bits(_fill(_singles(tasks))) == _bits(_fill(tasks))


def test_results_stand_where_their_member_and_slot_say():
    results = PopulationResults.empty(2, 3, 2)
    task = make_task(1, [5, 6], slots=(1, 0))
    result = make_result(task)
    results.add(task, result)
    assert results.returns[:, 1].tolist() == result.returns[:, ::-1].tolist()
    for name in BY_EPISODE:
        assert getattr(results, name)[1].tolist() == getattr(result, name)[::-1].tolist(), name
    assert not results.steps[[0, 2]].any()


def test_fitness_is_the_mean_return_over_episodes_at_each_level():
    results = PopulationResults.empty(2, 2, 2)
    results.returns[:] = [[[1, 3], [0, 0]], [[10, 20], [-1, 2]]]
    assert results.fitness.tolist() == [[2, 0], [15, 0.5]]


def _diverging(returns, has_diverged):
    results = PopulationResults.empty(1, len(returns), len(returns[0]))
    results.returns[:] = [returns]
    results.has_diverged[:] = has_diverged
    return results


def test_an_episode_that_diverged_counts_as_the_worst_of_the_others():
    # By breaking the physics the second member ended with -1, where the others have -3 and less.
    results = _diverging([[-3.0, -5.0], [-1.0, -4.0], [-6.0, -3.0]], [[0, 0], [1, 0], [0, 0]])
    assert results.fitness.tolist() == [[-4, -5, -4.5]]
    assert results.returns[0, 1].tolist() == [-1, -4]  # what is reported stays what it was


def test_an_episode_that_diverged_is_never_raised():
    assert _diverging([[3.0], [-9.0], [4.0]], [[0], [1], [0]]).fitness.tolist() == [[3, -9, 4]]


def test_where_all_diverged_there_is_nothing_to_compare_with():
    assert _diverging([[3.0], [-9.0]], [[1], [1]]).fitness.tolist() == [[3, -9]]


def test_the_worst_is_that_of_the_level_itself():
    results = PopulationResults.empty(2, 2, 1)
    results.returns[:] = [[[7.0], [9.0]], [[70.0], [60.0]]]
    results.has_diverged[1] = True
    assert results.fitness.tolist() == [[7, 7], [70, 60]]


def test_lowering_makes_no_copy_where_nothing_diverged_and_changes_no_argument():
    values = np.array([[1.0, 5.0], [3.0, 2.0]])
    assert lower_diverged(values, np.zeros((2, 2), bool)) is values
    assert lower_diverged(values, values == 5).tolist() == [[1, 1], [3, 2]]
    assert values.tolist() == [[1, 5], [3, 2]]


def test_seconds_are_added_up_over_all_results():
    assert len(PARTS) == 3
    for tasks in (population(6, 3), _singles(population(6, 3))):
        assert _fill(tasks).seconds.tolist() == [len(tasks), 0.5 * len(tasks), 0.25 * len(tasks)]


def _levels():
    return tuple(
        LevelState(
            name=f"of {size}",
            theta=np.zeros(1, np.float32),
            optimizer=Adam().start(1),
            statistics=ObservationStatistics.empty(size).merge(2, np.ones(size), np.ones(size)),
        )
        for size in SIZES
    )


def test_statistics_merge_what_was_recorded_and_nothing_else():
    tasks = population(6, 3)
    results = _fill(tasks)
    recorded = [make_result(task).moments for task in tasks if task.records_statistics]
    assert len(recorded) == 3
    for i, level in enumerate(results.merge_statistics(_levels(), (True, True))):
        assert level.statistics.count == 2 + sum(int(m[i].count.sum()) for m in recorded)
        assert level.statistics.total == pytest.approx(1 + sum(m[i].total.sum(axis=0) for m in recorded))
        assert level.statistics.total_squares == pytest.approx(
            1 + sum(m[i].total_squares.sum(axis=0) for m in recorded)
        )


def test_adding_leaves_a_result_as_it_was():
    task = make_task(0, [1, 2, 3])
    result = make_result(task)
    results = PopulationResults.empty(2, 1, 3)
    results.add(task, result)
    results.add(task, result)
    assert [m.total.tobytes() for m in result.moments] == [m.total.tobytes() for m in make_result(task).moments]
    assert [m.count.tolist() for m in result.moments] == [m.count.tolist() for m in make_result(task).moments]


def test_without_recorded_observations_the_levels_stay_the_same():
    results = PopulationResults.empty(2, 6, 3)
    task = make_task(1, [1, 2, 3])
    results.add(task, make_result(task))
    levels = _levels()
    merged = results.merge_statistics(levels, (True, True))
    assert all(mine is level for mine, level in zip(merged, levels, strict=True))


@pytest.mark.parametrize("learns", [(True, False), (False, True), (False, False)])
def test_the_statistics_of_a_frozen_level_stay_as_they_are(learns):
    results, levels = _fill(population(6, 3)), _levels()
    for level, merged, is_learning in zip(levels, results.merge_statistics(levels, learns), learns, strict=True):
        assert (merged is level) == (not is_learning)
        assert (merged.statistics.count > level.statistics.count) == is_learning
        assert merged.name == level.name


def test_counts_beyond_32_bits_stay_exact():
    results = PopulationResults.empty(2, 2, 3)
    for member in (0, 1):
        task = make_task(member, [1, 2, 3], records_statistics=True)
        result = make_result(task)
        for m in result.moments:
            m.count[:] = 2**40 + 1
        results.add(task, result)
    counts = [level.statistics.count for level in results.merge_statistics(_levels(), (True, True))]
    assert counts == [6 * (2**40 + 1) + 2] * 2


def test_the_simulators_lines_are_collected():
    results = PopulationResults.empty(2, 2, 3)
    for member, lines in ((0, ("a",)), (1, ()), (1, ("b", "c"))):
        task = make_task(member, [1, 2, 3])
        results.add(task, make_result(task, log=lines))
    assert results.log == ["a", "b", "c"]
