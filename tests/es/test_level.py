"""The update of a level, and the draws that it shares with the rollouts.

That it is the textbook's, `evolution/test_algorithm.py` and `test_strategy.py` say.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError
from shes.es.level import (
    LevelParameters,
    LevelState,
    UpdateRule,
    draw_noise_index,
    perturb,
    update_level,
)
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS, Adam
from shes.es.statistics import ObservationStatistics
from tests.es.textbook import SIGNS

DIMS = (7, 12)
RATE = 0.02
PAIR = np.array([[1, -1]], np.int8)
"""Signs [1, 2] of a single mirrored pair."""


@pytest.fixture(scope="module")
def table():
    return NoiseTable(np.random.default_rng(0).standard_normal(2000, dtype=np.float32))


def _level(theta, optimizer=None):
    theta = np.array(theta, np.float32)
    return LevelState(
        name="policy",
        theta=theta,
        optimizer=(optimizer or Adam()).start(len(theta)),
        statistics=ObservationStatistics.empty(3).merge(1, *np.ones((2, 3))),
    )


def _update(level, fitness, index, table, rule, *, signs=None):
    """Update from the fitness [n] of the whole population, as a generation does; of mirrored pairs without `signs`."""
    signs = np.tile(PAIR, (len(index), 1)) if signs is None else signs
    shaped = rule.shape(np.array(fitness, float), signs)
    return update_level(level, shaped, signs, np.array(index), table, rule, RATE)


def _bits(level):
    return level.theta.tobytes(), level.optimizer.steps, {k: v.tobytes() for k, v in level.optimizer.slots.items()}


@pytest.mark.parametrize("name", sorted(OPTIMIZERS))
def test_an_update_leaves_its_arguments_as_they_were(table, name):
    optimizer = OPTIMIZERS.find(name)()
    level = _level(np.ones(7), optimizer)
    shaped, signs, index = np.array([0.5, -0.5, 0.25, -0.25]), np.repeat(PAIR, 2, axis=0), np.array([0, 9])
    before = _bits(level)
    for array in (shaped, signs, index, level.theta, *level.optimizer.slots.values()):
        array.flags.writeable = False
    after = update_level(level, shaped, signs, index, table, UpdateRule(weight_decay=0.1, optimizer=optimizer), 0.1)
    assert _bits(level) == before
    assert after.level.optimizer.steps == 1
    assert after.level.optimizer.slots.keys() == level.optimizer.slots.keys()
    assert (after.level.name, after.level.statistics) == ("policy", level.statistics)
    assert after.level.theta.dtype == np.float32


@pytest.mark.parametrize("name", ["fall_price", "weight_decay"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_rule_out_of_range_is_refused(name, value):
    with pytest.raises(ConfigError, match=f"{name} must be zero or a positive number, got {value}"):
        UpdateRule(**{name: value})


def _moving_level(table, optimizer):
    """Return a level that has made a step, so that its optimizer has a momentum."""
    level = _level(np.linspace(-1, 2, 7), optimizer)
    return _update(level, [2, 1], [3], table, UpdateRule(optimizer=optimizer)).level


@pytest.mark.parametrize("name", sorted(OPTIMIZERS))
@pytest.mark.parametrize("fitness", [[0, 0, 0, 0], [5, 5, 3, 3]], ids=["all tie", "every pair ties"])
def test_a_tied_level_that_holds_stays_as_it_is(table, name, fitness):
    rule = UpdateRule(weight_decay=0.1, holds_when_tied=True, optimizer=OPTIMIZERS.find(name)())
    before = _moving_level(table, rule.optimizer)
    update = _update(before, fitness, [5, 90], table, rule)
    assert _bits(update.level) == _bits(before)
    assert (update.gradient_norm, update.update_ratio) == (0, 0)
    assert np.isnan(update.halves_cosine)


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_a_tied_level_goes_on_by_momentum_and_decay(table, decay):
    rule = UpdateRule(weight_decay=decay)
    before = _moving_level(table, rule.optimizer)
    update = _update(before, np.zeros(4), [5, 90], table, rule)
    step, optimizer = rule.optimizer.step(np.float32(-decay) * before.theta, before.optimizer, RATE)
    assert _bits(update.level) == _bits(replace(before, theta=before.theta + step, optimizer=optimizer))
    assert (update.level.theta != before.theta).all()


@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
def test_holding_changes_nothing_where_members_differ(table, mirrored):
    signs = np.tile(np.array(SIGNS[mirrored, 1], np.int8).T, (6, 1))
    fitness, index = np.zeros(signs.size), np.arange(6) * 100
    fitness[0] = 1e-9  # one member is better
    rules = [UpdateRule(weight_decay=0.1, holds_when_tied=holds) for holds in (False, True)]
    ends = [_update(_level(np.ones(7)), fitness, index, table, rule, signs=signs).level for rule in rules]
    assert _bits(ends[0]) == _bits(ends[1])
    assert ends[0].optimizer.steps == 1


@pytest.mark.parametrize("groups", [2, 3, 6, 7])
@pytest.mark.parametrize("mirrored", ["quad", "none"])
def test_diagnostics_equal_plain_sums(table, mirrored, groups):
    """The estimates of the first half of the groups (rounded down) and of the rest, member after member."""
    rng, members = np.random.default_rng(groups), np.array(SIGNS[mirrored, 2])[:, 1]
    signs = np.tile(members, (groups, 1)).astype(np.int8)
    level = _level(rng.normal(size=12))
    index, shaped = rng.integers(0, 1900, groups), rng.uniform(-0.5, 0.5, groups * len(members))
    update = update_level(level, shaped, signs, index, table, UpdateRule(weight_decay=0.3), RATE)
    halves = np.zeros((2, 12))
    for member, worth in enumerate(shaped):
        group = member // len(members)
        noise = table.values[index[group] : index[group] + 12].astype(float)
        halves[int(group >= groups // 2)] += worth * members[member % len(members)] * noise / len(shaped)
    first, second = halves
    assert update.halves_cosine == pytest.approx(
        first @ second / np.linalg.norm(first) / np.linalg.norm(second), abs=1e-5
    )
    assert update.gradient_norm == pytest.approx(np.linalg.norm(first + second), rel=1e-5)
    step = update.level.theta.astype(float) - level.theta
    assert update.update_ratio == pytest.approx(np.linalg.norm(step) / np.linalg.norm(level.theta), rel=1e-4)


def test_diagnostics_without_a_value_are_nan(table):
    def nans(theta, shaped, signs):
        signs = np.array(signs, np.int8)
        update = update_level(_level(theta), np.array(shaped), signs, np.array([5, 9])[: len(signs)], table,
                              UpdateRule(), RATE)  # fmt: skip
        values = {name: getattr(update, name) for name in ("gradient_norm", "halves_cosine", "update_ratio")}
        return [name for name, value in values.items() if np.isnan(value)]

    assert nans(np.ones(7), [], [[0, 0]] * 2) == ["gradient_norm", "halves_cosine", "update_ratio"]
    assert nans(np.zeros(7), [0.5, -0.5], [[1, -1]]) == ["halves_cosine", "update_ratio"]  # one group, no length
    assert nans(np.ones(7), [0, 0, 0.5, -0.5], [[1, -1]] * 2) == ["halves_cosine"]  # one half is zero


@given(
    seed=st.integers(0, 2**63), generation=st.integers(0, 10**6), groups=st.integers(1, 50), extra=st.integers(0, 40)
)
def test_every_noise_slice_lies_inside_the_table(seed, generation, groups, extra):
    assert set(draw_noise_index(0, 0, 500, (7,), 10)[0].tolist()) == {0, 1, 2, 3}  # the first and the last, too
    index = draw_noise_index(seed, generation, groups, DIMS, 12 + extra)
    assert index.shape == (2, groups)
    assert index.min() >= 0
    assert (index.max(axis=1) + DIMS <= 12 + extra).all()


def test_noise_differs_by_seed_generation_and_level_alone():
    rows = {
        (seed, generation, level): tuple(row)
        for seed, generation in ((0, 0), (1, 0), (0, 1))
        for level, row in enumerate(draw_noise_index(seed, generation, 20, (5, 5), 10**6))
    }
    assert len(set(rows.values())) == 6
    for dims, first in (((5,), 0), ((5, 100), 0), ((5,), 1)):  # the other levels have no effect
        assert tuple(draw_noise_index(0, 1, 20, dims, 10**6, first)[0]) == rows[0, 1, first]


@pytest.mark.parametrize("scale", [0.5, -0.5, 0.0])
def test_a_perturbation_is_theta_plus_scaled_noise(scale):
    theta, noise, out = (np.array(values, np.float32) for values in ([1, 2], [4, -2], [np.nan] * 2))
    perturb(theta, noise if scale else np.full(2, np.nan, np.float32), scale, out)
    assert out.tolist() == [1 + 4 * scale, 2 - 2 * scale]
    assert (theta.tolist(), noise.tolist()) == ([1, 2], [4, -2])


def test_parameters_have_the_normalisation_of_their_own_level():
    levels = [
        replace(
            _level([number, number]),
            statistics=ObservationStatistics.empty(1).merge(2, np.array([total]), np.full(1, 50)),
        )
        for number, total in ((1, 2.0), (2, 6.0))
    ]
    first, second = LevelParameters.of_all(levels)
    assert (first.theta.tolist(), first.mean.tolist()) == ([1, 1], [1])
    assert (second.theta.tolist(), second.mean.tolist()) == ([2, 2], [3])
    assert [1 / first.inverse_std[0] ** 2, 1 / second.inverse_std[0] ** 2] == pytest.approx([24, 16])
    assert (second.at_zero().theta.tolist(), second.at_zero().mean.tolist()) == ([0, 0], [3])
