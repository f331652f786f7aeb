"""The update of a level against the textbook, and the draws that it and the roll-outs share."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.es.level import LevelState, UpdateRule, draw_noise_index, perturb, update_level
from shes.es.mirror import sign_matrix
from shes.es.noise import NoiseTable
from shes.es.optimizers import Adam
from shes.es.statistics import ObservationStatistics
from tests.es.textbook import TextbookES

DIMS = (7, 12)
NUM_GROUPS = 6


@pytest.fixture(scope="module")
def table():
    return NoiseTable(np.random.default_rng(0).standard_normal(2000, dtype=np.float32))


def _level(theta):
    return LevelState(
        theta=theta,
        optimizer=Adam().start(len(theta)),
        statistics=ObservationStatistics.empty(3).merge(1, *np.ones((2, 3))),
    )


def _fitness(rng, num_levels, n, kind):
    if kind == "distinct":
        return rng.normal(size=(num_levels, n))
    return rng.integers(0, 3, (num_levels, n)).astype(float)  # sparse: nearly all members tie


@pytest.mark.parametrize("weight_decay", [0.0, 0.005])
@pytest.mark.parametrize("kind", ["distinct", "sparse"])
@pytest.mark.parametrize("ties", ["average", "index"])
@pytest.mark.parametrize("mirrored", ["quad", "pair", "none"])
@pytest.mark.parametrize("num_levels", [1, 2])
def test_the_update_is_the_textbooks(table, num_levels, mirrored, ties, kind, weight_decay):
    rng = np.random.default_rng(5)
    signs = sign_matrix(mirrored, num_levels)
    thetas = [rng.normal(size=dim).astype(np.float32) for dim in DIMS[:num_levels]]
    levels = [_level(theta) for theta in thetas]
    rule = UpdateRule(learning_rate=0.02, weight_decay=weight_decay, rank_ties=ties)
    book = TextbookES(thetas, mirrored=mirrored, sigma=0.1, rate=0.02, weight_decay=weight_decay, ties=ties)
    for generation in range(4):
        index = draw_noise_index(1, generation, NUM_GROUPS, DIMS[:num_levels], table.size)
        fitness = _fitness(rng, num_levels, NUM_GROUPS * len(signs), kind)
        noise = [[table.slice(i, dim) for i in row] for row, dim in zip(index, DIMS, strict=False)]
        before = levels
        levels = [update_level(level, fitness[i], signs[:, i], index[i], table, rule) for i, level in enumerate(levels)]
        book.update(fitness, noise)
        for i, level in enumerate(levels):
            # Adam's first moment, because Adam's step hides the gradient's scale.
            gradient = (level.optimizer.first.astype(float) - 0.9 * before[i].optimizer.first) / 0.1
            assert gradient == pytest.approx(book.gradients[i], rel=1e-4, abs=1e-6)
            assert level.theta == pytest.approx(book.thetas[i], rel=1e-5, abs=1e-5)
    assert np.abs(levels[0].theta - thetas[0]).max() > 0.02  # it went somewhere


def test_the_gradient_has_no_factor_of_sigma_and_divides_by_the_population():
    # One pair, noise (2, 0): ranks +0.5 and -0.5, so (0.5 + 0.5) * 2 / 2.
    table = NoiseTable(np.array([2, 0, 2, 0], np.float32))
    level = update_level(
        _level(np.zeros(2, np.float32)), np.array([9.0, 1.0]), np.array([1, -1], np.int8), np.array([0]), table,
        UpdateRule(learning_rate=0.1),
    )  # fmt: skip
    assert level.optimizer.first == pytest.approx([0.1, 0])
    assert level.theta == pytest.approx([0.1, 0])


def test_weight_decay_pulls_towards_zero():
    table = NoiseTable(np.zeros(4, np.float32))
    level = update_level(
        _level(np.array([4, -2], np.float32)), np.zeros(2), np.array([1, -1], np.int8), np.array([0]), table,
        UpdateRule(learning_rate=0.1, weight_decay=0.005),
    )  # fmt: skip
    assert level.optimizer.first == pytest.approx([-0.1 * 0.005 * 4, 0.1 * 0.005 * 2])


@pytest.mark.parametrize("ties", ["average", "index"])
def test_equal_fitness_moves_nothing_only_with_average_ranks(table, ties):
    level = _level(np.ones(7, np.float32))
    signs = sign_matrix("none", 1)[:, 0]
    after = update_level(
        level, np.zeros(8), signs, np.arange(8) * 20, table, UpdateRule(learning_rate=0.1, rank_ties=ties)
    )
    assert np.array_equal(after.theta, level.theta) == (ties == "average")


def test_an_update_leaves_the_level_and_the_fitness_as_they_were(table):
    level = _level(np.ones(7, np.float32))
    fitness = np.array([3.0, 1.0, 2.0, 0.0])
    after = update_level(
        level, fitness, np.array([1, -1], np.int8), np.array([0, 9]), table,
        UpdateRule(learning_rate=0.1, weight_decay=0.1),
    )  # fmt: skip
    assert fitness.tolist() == [3, 1, 2, 0]
    assert np.all(level.theta == 1)
    assert np.all(level.optimizer.first == 0)
    assert level.optimizer.steps == 0
    assert after.statistics is level.statistics
    assert after.theta.dtype == np.float32


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
