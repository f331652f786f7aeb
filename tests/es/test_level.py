"""The update of a level, and the draws that it shares with the rollouts.

That it is the textbook's, `evolution/test_algorithm.py` and `test_strategy.py` say.
"""

from dataclasses import replace

import numpy as np
import pytest

from shes.es.level import LevelState, UpdateRule, group_weights, update_level
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS, Adam
from tests.es.textbook import SIGNS

RATE = 0.02


@pytest.fixture(scope="module")
def table():
    return NoiseTable(np.random.default_rng(0).standard_normal(2000, dtype=np.float32))


def level_of(theta, optimizer=None):
    return LevelState.start("policy", np.array(theta, np.float32), optimizer or Adam(), 3)


def updated(level, fitness, index, table, rule):
    """Update from the fitness [n] of a population of mirrored pairs, as a generation does."""
    signs = np.tile(np.array([[1, -1]], np.int8), (len(index), 1))
    return update_level(level, rule.shape(np.array(fitness, float), signs), signs, np.array(index), table, rule, RATE)


def bits_of(level):
    return level.theta.tobytes(), level.optimizer.steps, {k: v.tobytes() for k, v in level.optimizer.slots.items()}


def moving_level(table, optimizer):
    """Return a level that has made a step, so that its optimizer has a momentum."""
    start = level_of(np.linspace(-1, 2, 7), optimizer)
    return updated(start, [2, 1], [3], table, UpdateRule(optimizer=optimizer)).level


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("fitness", [[0, 0, 0, 0], [5, 5, 3, 3]], ids=["all tie", "every pair ties"])
def test_a_tied_level_that_holds_stays_as_it_is(table, name, fitness):
    rule = UpdateRule(weight_decay=0.1, holds_when_tied=True, optimizer=OPTIMIZERS.find(name)())
    before = moving_level(table, rule.optimizer)
    update = updated(before, fitness, [5, 90], table, rule)
    assert bits_of(update.level) == bits_of(before)
    assert (update.gradient_norm, update.update_ratio) == (0, 0)
    assert np.isnan(update.halves_cosine)


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_a_tied_level_goes_on_by_momentum_and_decay(table, decay):
    rule = UpdateRule(weight_decay=decay)
    before = moving_level(table, rule.optimizer)
    update = updated(before, np.zeros(4), [5, 90], table, rule)
    step, optimizer = rule.optimizer.step(np.float32(-decay) * before.theta, before.optimizer, RATE)
    assert bits_of(update.level) == bits_of(replace(before, theta=before.theta + step, optimizer=optimizer))


def test_holding_changes_nothing_where_members_differ(table):
    rules = [UpdateRule(weight_decay=0.1, holds_when_tied=holds) for holds in (False, True)]
    ends = [updated(level_of(np.ones(7)), [1e-9, *[0] * 11], np.arange(6), table, rule).level for rule in rules]
    assert bits_of(ends[0]) == bits_of(ends[1])
    assert ends[0].optimizer.steps == 1


@pytest.mark.parametrize("groups", [2, 7])
@pytest.mark.parametrize("mirrored", ["quad", "none"])
def test_diagnostics_equal_plain_sums(table, mirrored, groups):
    """The estimates of the first half of the groups (rounded down) and of the rest, member after member."""
    rng, members = np.random.default_rng(groups), np.array(SIGNS[mirrored, 2])[:, 1]
    signs = np.tile(members, (groups, 1)).astype(np.int8)
    level = level_of(rng.normal(size=12))
    index, shaped = rng.integers(0, 1900, groups), rng.uniform(-0.5, 0.5, groups * len(members))
    update = update_level(level, shaped, signs, index, table, UpdateRule(weight_decay=0.3), RATE)
    halves = np.zeros((2, 12))
    for member, worth in enumerate(shaped):
        group = member // len(members)
        noise = table.values[index[group] : index[group] + 12].astype(float)
        halves[int(group >= groups // 2)] += worth * members[member % len(members)] * noise / len(shaped)
    (first, second), norm = halves, np.linalg.norm
    assert update.halves_cosine == pytest.approx(first @ second / norm(first) / norm(second), abs=1e-5)
    assert update.gradient_norm == pytest.approx(norm(first + second), rel=1e-5)
    step = update.level.theta.astype(float) - level.theta
    assert update.update_ratio == pytest.approx(norm(step) / norm(level.theta), rel=1e-4)


@pytest.mark.parametrize(
    ("theta", "shaped", "signs", "names"),
    [
        (1, [], [[0, 0]] * 2, ["gradient_norm", "halves_cosine", "update_ratio"]),
        (0, [0.5, -0.5], [[1, -1]], ["halves_cosine", "update_ratio"]),  # one group, no length
        (1, [0, 0, 0.5, -0.5], [[1, -1]] * 2, ["halves_cosine"]),  # one half is zero
    ],
)
def test_diagnostics_without_a_value_are_nan(table, theta, shaped, signs, names):
    index, signs = np.array([5, 9])[: len(signs)], np.array(signs, np.int8)
    update = update_level(level_of([theta] * 7), np.array(shaped), signs, index, table, UpdateRule(), RATE)
    assert [name for name, value in vars(update).items() if name != "level" and np.isnan(value)] == names


@pytest.mark.parametrize("values", [(0.1, 0.2), (1e-17, 1.0), (-0.3, 0.7)])
def test_equal_fitness_on_both_sides_cancels_exactly(values):
    # An optimizer that ignores the gradient's length would take a rounding error for a direction.
    one, other = values
    signs = np.array([[1, 1, 1, -1, -1, -1]] * 3, np.int8)
    shaped = np.array([[one, other, 0.6, 0.6, one, other], [0.6, other, one, one, other, 0.6], [one] * 6])
    assert group_weights(shaped.ravel(), signs).tolist() == [0, 0, 0]
