"""The weighted sum of noise: equal to a plain sum, and bit-identical for any number of blocks and threads."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shes.es import gradient
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.mirror import sign_matrix
from shes.es.noise import NoiseTable

DIM = 20_000  # three blocks, the last one short


@pytest.fixture(scope="module")
def table():
    return NoiseTable(np.random.default_rng(0).standard_normal(100_000, dtype=np.float32))


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(1)
    return rng.integers(0, 100_000 - DIM + 1, 30), rng.normal(size=30).astype(np.float32)


@given(num_groups=st.integers(1, 8), mirrored=st.sampled_from(["quad", "pair", "none"]), seed=st.integers(0, 2**32))
def test_group_weights_are_signed_sums_over_members(num_groups, mirrored, seed):
    members = sign_matrix(mirrored, 2)
    rng = np.random.default_rng(seed)
    shaped = rng.uniform(-0.5, 0.5, num_groups * len(members))
    # Groups may differ in their signs: some are turned around here, as no caller does yet.
    signs = members * rng.choice([-1, 1], (num_groups, 1, 1)).astype(np.int8)
    for level in (0, 1):
        weights = group_weights(shaped, signs[:, :, level])
        assert weights.shape == (num_groups,)
        assert weights.dtype == np.float32
        for group in range(num_groups):
            own = shaped[group * len(members) : (group + 1) * len(members)]
            assert weights[group] == pytest.approx(
                sum(s * f for s, f in zip(signs[group, :, level], own, strict=True)), abs=1e-6
            )


def test_the_controllers_signs_are_blind_to_the_primitives_effect():
    # A fitness that depends on the primitive's sign alone: orthogonal columns leave the controller nothing.
    signs = sign_matrix("quad", 2)
    shaped = 0.3 * signs[:, 1].astype(float)
    assert group_weights(shaped, signs[None, :, 0])[0] == 0
    assert group_weights(shaped, signs[None, :, 1])[0] == pytest.approx(1.2)


def test_group_weights_leave_the_shaped_fitness_as_it_was():
    shaped = np.array([0.5, -0.5, 0.25, -0.25])
    group_weights(shaped, np.array([[1, -1], [1, -1]], np.int8))
    assert shaped.tolist() == [0.5, -0.5, 0.25, -0.25]


def test_the_sum_is_that_of_a_plain_loop(table, drawn):
    index, weights = drawn
    expected = np.zeros(DIM)
    for start, weight in zip(index, weights, strict=True):
        expected += float(weight) * table.values[start : start + DIM].astype(float)
    total = weighted_noise_sum(table, index, weights, DIM)
    assert total.dtype == np.float32
    assert total == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_do_not_change_a_bit(table, drawn, threads):
    with ThreadPoolExecutor(threads) as pool:
        shared = weighted_noise_sum(table, *drawn, DIM, pool)
    assert shared.tobytes() == weighted_noise_sum(table, *drawn, DIM).tobytes()


@pytest.mark.parametrize("columns", [1000, 4096, 8191, 1 << 20])
def test_the_width_of_a_block_does_not_change_a_bit(table, drawn, columns, monkeypatch):
    expected = weighted_noise_sum(table, *drawn, DIM)
    monkeypatch.setattr(gradient, "_COLUMNS", columns)
    assert weighted_noise_sum(table, *drawn, DIM).tobytes() == expected.tobytes()


@settings(max_examples=40)
@given(dim=st.integers(1, DIM))
def test_a_columns_sum_does_not_depend_on_how_many_columns_there_are(table, drawn, dim):
    whole = weighted_noise_sum(table, *drawn, DIM)
    assert weighted_noise_sum(table, *drawn, dim).tobytes() == whole[:dim].tobytes()


def test_groups_of_weight_zero_are_not_read():
    values = np.ones(1000, np.float32)
    values[:100] = np.nan
    index, weights = np.array([0, 200, 10, 300]), np.array([0, 2, -0.0, 3], np.float32)
    assert np.all(weighted_noise_sum(NoiseTable(values), index, weights, 50) == 5)


def test_no_weight_at_all_is_no_gradient(table):
    assert np.all(weighted_noise_sum(table, np.zeros(3, int), np.zeros(3, np.float32), 10) == 0)


def test_the_last_slice_of_the_table_counts_whole():
    values = np.arange(100, dtype=np.float32)
    assert weighted_noise_sum(NoiseTable(values), np.array([90]), np.ones(1, np.float32), 10).tolist() == list(
        range(90, 100)
    )


@pytest.mark.parametrize("values", [(0.1, 0.2), (1e-17, 1.0), (-0.3, 0.7)])
def test_equal_fitness_on_both_sides_of_a_vector_cancels_exactly(values):
    # An optimizer that does not heed the gradient's length would take what rounding leaves for a direction.
    one, other = values
    signs = np.array([[1, 1, 1, -1, -1, -1]] * 3, np.int8)
    shaped = np.array([[one, other, 0.6, 0.6, one, other], [0.6, other, one, one, other, 0.6], [one] * 6])
    assert group_weights(shaped.ravel(), signs).tolist() == [0, 0, 0]
