"""The update of a level against the textbook, and the draws that it and the roll-outs share."""

from concurrent.futures import ThreadPoolExecutor
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
    select_fitness,
    update_level,
)
from shes.es.noise import NoiseTable
from shes.es.optimizers import OPTIMIZERS, SGD, Adam
from shes.es.perturbation import PERTURBATIONS
from shes.es.shaping import CentredRanks
from shes.es.statistics import ObservationStatistics
from tests.es.textbook import SIGNS, TextbookES

DIMS = (7, 12)
NUM_GROUPS = 6
RATE = 0.02
PAIR = np.array([[1, -1]], np.int8)
"""Signs [1, 2] of a single mirrored pair."""


@pytest.fixture(scope="module")
def table():
    return NoiseTable(np.random.default_rng(0).standard_normal(2000, dtype=np.float32))


def _level(theta, optimizer=None):
    return LevelState(
        name="policy",
        theta=theta,
        optimizer=(optimizer or Adam()).start(len(theta)),
        statistics=ObservationStatistics.empty(3).merge(1, *np.ones((2, 3))),
    )


def _update(level, fitness, signs, index, table, rule, *, rate=RATE, pool=None):
    """Update from the fitness [n] of the whole population, as a generation does."""
    shaped = rule.shaping(select_fitness(fitness, signs)) if signs.any() else np.zeros(0)
    return update_level(level, shaped, signs, index, table, rule, rate, pool)


def _fitness(rng, num_levels, n, kind):
    if kind == "distinct":
        return rng.normal(size=(num_levels, n))
    return rng.integers(0, 3, (num_levels, n)).astype(float)  # sparse: nearly all members tie


def _gradient(after, before):
    """Return the gradient by Adam's first moment, because Adam's step hides its scale."""
    return (after.optimizer.slots["first"].astype(float) - 0.9 * before.optimizer.slots["first"]) / 0.1


def _check_against_textbook(table, kind, *, learns, generations=4, **options):
    """Compare levels with the textbook's, generation after generation; return the levels after each."""
    num_levels, mirrored = len(learns), options.get("mirrored", "quad")
    ties, weight_decay = options.get("ties", "average"), options.get("weight_decay", 0.0)
    perturbation = options.get("perturbation", "many_to_many")
    rng = np.random.default_rng(5)
    thetas = [rng.normal(size=dim).astype(np.float32) for dim in DIMS[:num_levels]]
    levels = [_level(theta) for theta in thetas]
    rule = UpdateRule(weight_decay=weight_decay, shaping=CentredRanks(rank_ties=ties))
    book = TextbookES(thetas, sigma=0.1, rate=RATE, learns=learns, **{"mirrored": mirrored, **options})
    members = len(SIGNS[mirrored, 1 if perturbation != "many_to_many" else sum(learns)])
    history = [levels]
    for generation in range(generations):
        signs = PERTURBATIONS.find(perturbation)().signs(generation, NUM_GROUPS * members, mirrored, learns)
        index = draw_noise_index(1, generation, NUM_GROUPS, DIMS[:num_levels], table.size)
        fitness = _fitness(rng, num_levels, NUM_GROUPS * members, kind)
        noise = [[table.slice(i, dim) for i in row] for row, dim in zip(index, DIMS, strict=False)]
        before = levels
        levels = [
            _update(level, fitness[i], signs[:, :, i], index[i], table, rule).level for i, level in enumerate(levels)
        ]
        book.update(fitness, noise)
        for i, level in enumerate(levels):
            if book.gradients[i] is None:
                assert level is before[i]
                continue
            assert _gradient(level, before[i]) == pytest.approx(book.gradients[i], rel=1e-4, abs=1e-6)
            assert level.theta == pytest.approx(book.thetas[i], rel=1e-5, abs=1e-5)
        history.append(levels)
    return history


@pytest.mark.parametrize("weight_decay", [0.0, 0.005])
@pytest.mark.parametrize("kind", ["distinct", "sparse"])
@pytest.mark.parametrize("ties", ["average", "index"])
@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("num_levels", [1, 2])
def test_the_update_is_the_textbooks(table, num_levels, mirrored, ties, kind, weight_decay):
    history = _check_against_textbook(
        table, kind, learns=[True] * num_levels, mirrored=mirrored, ties=ties, weight_decay=weight_decay
    )
    assert np.abs(history[-1][0].theta - history[0][0].theta).max() > 0.02  # it went somewhere


@pytest.mark.parametrize("kind", ["distinct", "sparse"])
@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("learns", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("perturbation", sorted(PERTURBATIONS))
def test_the_update_is_the_textbooks_whichever_level_is_perturbed(table, perturbation, learns, mirrored, kind):
    history = _check_against_textbook(
        table, kind, learns=learns, mirrored=mirrored, perturbation=perturbation, weight_decay=0.005
    )
    moved = [not np.array_equal(one.theta, other.theta) for one, other in zip(history[0], history[-1], strict=True)]
    assert moved == list(learns)


def test_a_level_that_is_not_perturbed_keeps_everything(table):
    before = _update(
        _level(np.ones(7, np.float32)), np.array([2.0, 1.0]), PAIR, np.array([3]), table, UpdateRule()
    ).level
    after = update_level(
        before, np.zeros(0), np.zeros((4, 2), np.int8), np.arange(4), table, UpdateRule(weight_decay=0.5), RATE
    )
    assert after.level is before  # not even weight decay moves it, and Adam does not count a step


def test_only_the_members_that_perturb_a_level_count_in_its_update(table):
    # Groups 0 and 2 perturb it; the same update comes from a population of these two groups alone.
    level, rule = _level(np.ones(7, np.float32)), UpdateRule(weight_decay=0.01)
    signs = np.array([[1, -1], [0, 0], [1, -1], [0, 0]], np.int8)
    fitness, index = np.array([4.0, 1, 99, -99, 2, 3, 50, 60]), np.array([5, 100, 300, 700])
    mixed = _update(level, fitness, signs, index, table, rule)
    alone = _update(level, fitness[[0, 1, 4, 5]], signs[[0, 2]], index[[0, 2]], table, rule)
    assert mixed.level.theta.tobytes() == alone.level.theta.tobytes()
    assert (mixed.gradient_norm, mixed.halves_cosine, mixed.update_ratio) == (
        alone.gradient_norm, alone.halves_cosine, alone.update_ratio
    )  # fmt: skip
    # n' = 4, not 8: ranks 0.5, -0.5, -1/6, 1/6.
    noise = [table.slice(i, 7).astype(float) for i in (5, 300)]
    assert _gradient(mixed.level, level) == pytest.approx((noise[0] - noise[1] / 3) / 4 - 0.01, abs=1e-6)


@pytest.mark.parametrize(
    ("signs", "selected"),
    [
        ([[1, -1], [1, -1], [1, -1]], [0, 1, 2, 3, 4, 5]),
        ([[1, -1], [0, 0], [-1, 1]], [0, 1, 4, 5]),
        ([[0, 0], [0, 0], [1, -1]], [4, 5]),
        ([[0, 0], [0, 0], [0, 0]], []),
        ([[1], [0], [0], [1], [1], [0]], [0, 3, 4]),
    ],
)
def test_the_fitness_of_a_level_is_that_of_the_groups_that_perturb_it(signs, selected):
    fitness = np.array([0.0, 1, 2, 3, 4, 5])
    assert select_fitness(fitness, np.array(signs, np.int8)).tolist() == selected
    assert fitness.tolist() == [0, 1, 2, 3, 4, 5]


def test_the_gradient_has_no_factor_of_sigma_and_divides_by_the_population():
    # One pair, noise (2, 0): ranks +0.5 and -0.5, so (0.5 + 0.5) * 2 / 2.
    table = NoiseTable(np.array([2, 0, 2, 0], np.float32))
    update = _update(
        _level(np.zeros(2, np.float32)), np.array([9.0, 1.0]), PAIR, np.array([0]), table, UpdateRule(), rate=0.1
    )
    assert update.level.optimizer.slots["first"] == pytest.approx([0.1, 0])
    assert update.level.theta == pytest.approx([0.1, 0])
    assert update.gradient_norm == pytest.approx(1)


def test_weight_decay_pulls_towards_zero():
    table = NoiseTable(np.zeros(4, np.float32))
    update = _update(
        _level(np.array([4, -2], np.float32)), np.zeros(2), PAIR, np.array([0]), table, UpdateRule(weight_decay=0.005)
    )
    assert update.level.optimizer.slots["first"] == pytest.approx([-0.1 * 0.005 * 4, 0.1 * 0.005 * 2])
    assert update.gradient_norm == 0  # of the estimate, without the decay


@pytest.mark.parametrize("ties", ["average", "index"])
def test_equal_fitness_moves_nothing_only_with_average_ranks(table, ties):
    level = _level(np.ones(7, np.float32))
    signs = np.ones((8, 1), np.int8)
    rule = UpdateRule(shaping=CentredRanks(rank_ties=ties))
    after = _update(level, np.zeros(8), signs, np.arange(8) * 20, table, rule).level
    assert np.array_equal(after.theta, level.theta) == (ties == "average")


@pytest.mark.parametrize("name", sorted(OPTIMIZERS))
def test_an_update_leaves_its_arguments_as_they_were(table, name):
    optimizer = OPTIMIZERS.find(name)()
    level = _level(np.ones(7, np.float32), optimizer)
    shaped, signs, index = np.array([0.5, -0.5, 0.25, -0.25]), np.repeat(PAIR, 2, axis=0), np.array([0, 9])
    for array in (shaped, signs, index, level.theta, *level.optimizer.slots.values()):
        array.flags.writeable = False
    after = update_level(level, shaped, signs, index, table, UpdateRule(weight_decay=0.1, optimizer=optimizer), 0.1)
    assert shaped.tolist() == [0.5, -0.5, 0.25, -0.25]
    assert np.all(level.theta == 1)
    assert not any(slot.any() for slot in level.optimizer.slots.values())
    assert level.optimizer.steps == 0
    assert after.level.optimizer.steps == 1
    assert after.level.optimizer.slots.keys() == level.optimizer.slots.keys()
    assert after.level.statistics is level.statistics
    assert after.level.name == "policy"
    assert after.level.theta.dtype == np.float32
    assert not np.array_equal(after.level.theta, level.theta)


def test_the_step_is_the_optimizers_with_the_rate_given(table):
    level, rule = _level(np.ones(7, np.float32), SGD()), UpdateRule(optimizer=SGD(momentum=0.0))
    fitness, index = np.array([4.0, 1.0]), np.array([5])
    for rate in (0.1, 0.4):
        after = _update(level, fitness, PAIR, index, table, rule, rate=rate)
        assert after.level.theta == pytest.approx(1 + rate * table.slice(5, 7) / 2, abs=1e-6)


# A level without information, and decay beside the optimizer ----------------------------------------------------------


def _moving_level(table, rule):
    """Return a level that has made a step, so that its optimizer has a momentum."""
    level = _level(np.linspace(-1, 2, 7).astype(np.float32), rule.optimizer)
    return _update(level, np.array([2.0, 1.0]), PAIR, np.array([3]), table, UpdateRule(optimizer=rule.optimizer)).level


def _bits(level):
    return level.theta.tobytes(), level.optimizer.steps, {k: v.tobytes() for k, v in level.optimizer.slots.items()}


@pytest.mark.parametrize("name", sorted(OPTIMIZERS))
@pytest.mark.parametrize("fitness", [[0, 0, 0, 0], [5, 5, 3, 3]], ids=["all tie", "every pair ties"])
def test_a_level_that_holds_stays_as_it_is_where_no_direction_is_worth_anything(table, name, fitness):
    rule = UpdateRule(weight_decay=0.1, holds_when_tied=True, optimizer=OPTIMIZERS.find(name)())
    before = _moving_level(table, rule)
    signs, index = np.tile(PAIR, (2, 1)), np.array([5, 90])
    update = _update(before, np.array(fitness, float), signs, index, table, rule)
    assert _bits(update.level) == _bits(before)
    assert (update.gradient_norm, update.update_ratio) == (0, 0)
    assert np.isnan(update.halves_cosine)


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_a_level_that_does_not_hold_goes_on_by_its_momentum_and_its_decay(table, decay):
    rule = UpdateRule(weight_decay=decay)
    before = _moving_level(table, rule)
    update = _update(before, np.zeros(4), np.tile(PAIR, (2, 1)), np.array([5, 90]), table, rule)
    assert update.gradient_norm == 0
    assert update.level.optimizer.steps == before.optimizer.steps + 1
    assert (update.level.theta != before.theta).all()
    step, _ = rule.optimizer.step(np.float32(-decay) * before.theta, before.optimizer, RATE)
    assert update.level.theta == pytest.approx(before.theta + step)


def test_without_momentum_the_decay_alone_moves_a_level_that_does_not_hold(table):
    level, fitness = _level(np.ones(7, np.float32)), np.zeros(2)
    moved = {
        (holds, decay): not np.array_equal(
            _update(
                level, fitness, PAIR, np.array([3]), table, UpdateRule(weight_decay=decay, holds_when_tied=holds)
            ).level.theta,
            level.theta,
        )
        for holds in (False, True)
        for decay in (0.0, 0.1)
    }
    assert moved == {(False, 0.0): False, (False, 0.1): True, (True, 0.0): False, (True, 0.1): False}


@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
def test_holding_changes_nothing_where_there_is_something_to_learn(table, mirrored):
    signs = PERTURBATIONS.find("many_to_many")().signs(0, NUM_GROUPS * len(SIGNS[mirrored, 1]), mirrored, (True,))
    fitness, index = np.zeros(signs.shape[0] * signs.shape[1]), np.arange(NUM_GROUPS) * 100
    fitness[0] = 1e-9  # one member is better
    ends = [
        _update(
            _level(np.ones(7, np.float32)), fitness, signs[:, :, 0], index, table,
            UpdateRule(weight_decay=0.1, holds_when_tied=holds),
        ).level
        for holds in (False, True)
    ]  # fmt: skip
    assert _bits(ends[0]) == _bits(ends[1])
    assert ends[0].optimizer.steps == 1


@pytest.mark.parametrize("price", [-0.1, float("nan"), float("inf")])
def test_a_fall_price_out_of_range_is_refused(price):
    with pytest.raises(ConfigError, match=r"fall_price must be zero or a positive number, got "):
        UpdateRule(fall_price=price)


@pytest.mark.parametrize("decay", [-0.1, float("nan"), float("inf")])
def test_a_weight_decay_out_of_range_is_refused(decay):
    with pytest.raises(ConfigError, match=f"weight_decay must be zero or a positive number, got {decay}"):
        UpdateRule(weight_decay=decay)


# What is to be known of an update --------------------------------------------------------------------------------


@pytest.mark.parametrize("groups", [2, 3, 6, 7])
@pytest.mark.parametrize("mirrored", ["quad", "none"])
def test_the_diagnostics_are_those_of_plain_sums(table, mirrored, groups):
    """The estimates of the first half of the groups (rounded down) and of the rest, member after member."""
    rng = np.random.default_rng(groups)
    members = np.array(SIGNS[mirrored, 2])[:, 1]
    signs = np.tile(members, (groups, 1)).astype(np.int8)
    level, rule = _level(rng.normal(size=12).astype(np.float32)), UpdateRule(weight_decay=0.3)
    index, shaped = rng.integers(0, 1900, groups), rng.uniform(-0.5, 0.5, groups * len(members))
    update = update_level(level, shaped, signs, index, table, rule, RATE)
    halves = [np.zeros(12), np.zeros(12)]
    for member, worth in enumerate(shaped):
        group = member // len(members)
        noise = table.values[index[group] : index[group] + 12].astype(float)
        halves[group >= groups // 2] += worth * members[member % len(members)] * noise / len(shaped)
    first, second = halves
    cosine = sum(first * second) / np.sqrt(sum(first**2) * sum(second**2))
    assert update.halves_cosine == pytest.approx(cosine, abs=1e-5)
    assert update.gradient_norm == pytest.approx(np.sqrt(sum((first + second) ** 2)), rel=1e-5)
    step = update.level.theta.astype(float) - level.theta
    assert update.update_ratio == pytest.approx(np.sqrt(sum(step**2) / sum(level.theta.astype(float) ** 2)), rel=1e-4)
    assert _gradient(update.level, level) == pytest.approx(first + second - 0.3 * level.theta, abs=1e-5)


def test_the_halves_agree_on_a_signal_and_not_on_noise():
    """A fitness that is the noise's first component, and one that is drawn: the cosine tells them apart."""
    rng = np.random.default_rng(0)
    table = NoiseTable(rng.standard_normal(50_000, dtype=np.float32))
    index, signs, level = rng.integers(0, 49_000, 400), np.tile(PAIR, (400, 1)), _level(np.ones(5, np.float32))
    signal = np.stack([table.values[index], -table.values[index]], axis=1).ravel().astype(float)
    cosines = [
        _update(level, fitness, signs, index, table, UpdateRule()).halves_cosine
        for fitness in (signal, rng.normal(size=800))
    ]
    assert cosines[0] > 0.95
    assert abs(cosines[1]) < 0.9


def test_there_is_nothing_to_know_of_a_level_that_was_not_perturbed(table):
    level = _level(np.ones(7, np.float32))
    update = update_level(level, np.zeros(0), np.zeros((2, 2), np.int8), np.zeros(2, int), table, UpdateRule(), RATE)
    assert np.isnan([update.gradient_norm, update.halves_cosine, update.update_ratio]).all()


def test_a_ratio_with_nothing_below_the_line_is_nan(table):
    # A single group has no two halves, parameters of zero no length.
    update = _update(_level(np.zeros(7, np.float32)), np.array([2.0, 1.0]), PAIR, np.array([5]), table, UpdateRule())
    assert np.isnan(update.halves_cosine)
    assert np.isnan(update.update_ratio)
    assert update.gradient_norm == pytest.approx(np.linalg.norm(table.slice(5, 7).astype(float)) / 2)
    # Neither do halves agree of which one is zero.
    signs, shaped = np.repeat(PAIR, 2, axis=0), np.array([0.0, 0.0, 0.5, -0.5])
    update = update_level(_level(np.ones(7, np.float32)), shaped, signs, np.array([5, 9]), table, UpdateRule(), RATE)
    assert np.isnan(update.halves_cosine)
    assert update.update_ratio > 0


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_no_bit_of_an_update(threads):
    rng = np.random.default_rng(3)
    table = NoiseTable(rng.standard_normal(300_000, dtype=np.float32))
    level = _level(rng.normal(size=140_000).astype(np.float32))  # three blocks of columns
    signs, index, fitness = np.tile(PAIR, (6, 1)), rng.integers(0, 160_000, 6), rng.normal(size=12)
    plain = _update(level, fitness, signs, index, table, UpdateRule())
    with ThreadPoolExecutor(threads) as pool:
        shared = _update(level, fitness, signs, index, table, UpdateRule(), pool=pool)
    assert shared.level.theta.tobytes() == plain.level.theta.tobytes()
    assert (shared.gradient_norm, shared.halves_cosine, shared.update_ratio) == (
        plain.gradient_norm, plain.halves_cosine, plain.update_ratio
    )  # fmt: skip


# Draws that update and roll-outs share -----------------------------------------------------------------------------


@given(
    seed=st.integers(0, 2**63), generation=st.integers(0, 10**6), groups=st.integers(1, 50), extra=st.integers(0, 40)
)
def test_every_noise_slice_lies_inside_the_table(seed, generation, groups, extra):
    size = 12 + extra
    index = draw_noise_index(seed, generation, groups, DIMS, size)
    assert index.shape == (2, groups)
    for row, dim in zip(index, DIMS, strict=True):
        assert row.min() >= 0
        assert row.max() + dim <= size


def test_the_first_and_the_last_slice_of_the_table_are_drawn():
    index = draw_noise_index(0, 0, 500, (7,), 10)
    assert set(index[0].tolist()) == {0, 1, 2, 3}


def test_noise_places_differ_by_seed_generation_and_level_and_by_nothing_else():
    draws = [
        draw_noise_index(seed, generation, 20, (5, 5), 10**6) for seed, generation in ((0, 0), (1, 0), (0, 1), (0, 0))
    ]
    assert np.array_equal(draws[0], draws[3])
    rows = [tuple(row) for draw in draws[:3] for row in draw]
    assert len(set(rows)) == 6


def test_a_levels_draws_do_not_depend_on_the_other_levels():
    both = draw_noise_index(3, 4, 20, (5, 9), 10**6)
    assert np.array_equal(draw_noise_index(3, 4, 20, (5,), 10**6)[0], both[0])
    assert np.array_equal(draw_noise_index(3, 4, 20, (5, 100), 10**6)[0], both[0])


@pytest.mark.parametrize("scale", [0.5, -0.5, 0.0])
def test_a_perturbation_is_theta_plus_scaled_noise(scale):
    theta, noise = np.array([1.0, 2.0], np.float32), np.array([4.0, -2.0], np.float32)
    out = np.full(2, np.nan, np.float32)
    perturb(theta, noise, scale, out)
    assert out.tolist() == [1 + 4 * scale, 2 - 2 * scale]
    assert (theta.tolist(), noise.tolist()) == ([1, 2], [4, -2])


def test_without_a_perturbation_the_noise_is_not_looked_at():
    out = np.zeros(2, np.float32)
    perturb(np.ones(2, np.float32), np.full(2, np.nan, np.float32), 0.0, out)
    assert out.tolist() == [1, 1]


def test_states_are_frozen():
    level = _level(np.zeros(2, np.float32))
    with pytest.raises(AttributeError):
        level.theta = np.ones(2)  # type: ignore[misc]
    assert replace(level, theta=np.ones(2, np.float32)).theta.tolist() == [1, 1]


def test_all_levels_are_frozen_with_the_normalisation_of_their_own_statistics():
    levels = [
        replace(
            _level(np.full(2, number, np.float32)),
            statistics=ObservationStatistics.empty(1).merge(2, total, 50 * np.ones(1)),
        )
        for number, total in ((1, np.array([2.0])), (2, np.array([6.0])))
    ]
    first, second = LevelParameters.of_all(levels)
    assert (first.theta.tolist(), first.mean.tolist()) == ([1, 1], [1])
    assert (second.theta.tolist(), second.mean.tolist()) == ([2, 2], [3])
    assert [1 / first.inverse_std[0] ** 2, 1 / second.inverse_std[0] ** 2] == pytest.approx([24, 16])
