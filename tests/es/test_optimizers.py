"""Adam against numbers worked out by hand."""

import numpy as np
import pytest

from shes.es.optimizers import Adam
from tests.es import textbook


def test_the_first_two_steps_are_those_worked_out_by_hand():
    # Gradients 0.5 and -0.25, rate 0.1. m1 = 0.05, v1 = 0.00025, m^ = 0.5, v^ = 0.25: step 0.1 * 0.5 / 0.5.
    # m2 = 0.045 - 0.025 = 0.02, v2 = 0.00024975 + 0.0000625 = 0.00031225, m^ = 0.02 / 0.19, v^ = 0.00031225 / 0.001999:
    # step 0.1 * 0.1052632 / 0.3952249.
    adam = Adam()
    step, state = adam.step(np.array([0.5], np.float32), adam.start(1), 0.1)
    assert step[0] == pytest.approx(0.1, rel=1e-6)
    assert (state.first[0], state.second[0], state.steps) == (pytest.approx(0.05), pytest.approx(0.00025), 1)
    step, state = adam.step(np.array([-0.25], np.float32), state, 0.1)
    assert step[0] == pytest.approx(0.0266337, rel=1e-5)
    assert (state.first[0], state.second[0], state.steps) == (pytest.approx(0.02), pytest.approx(0.00031225), 2)


def test_many_steps_are_those_of_kingma_and_ba():
    adam, plain = Adam(), textbook.Adam(6)
    state = adam.start(6)
    rng = np.random.default_rng(0)
    for _ in range(50):
        gradient = rng.normal(size=6).astype(np.float32)
        step, state = adam.step(gradient, state, 0.01)
        assert step == pytest.approx(plain.step(gradient.tolist(), 0.01), rel=1e-4, abs=1e-8)


def test_a_step_goes_uphill():
    step, _ = Adam().step(np.array([2.0, -3.0], np.float32), Adam().start(2), 0.01)
    assert step == pytest.approx([0.01, -0.01])


def test_no_gradient_is_no_step():
    step, state = Adam().step(np.zeros(3, np.float32), Adam().start(3), 0.01)
    assert step.tolist() == [0, 0, 0]
    assert state.steps == 1


def test_the_first_step_does_not_depend_on_the_gradients_scale():
    gradient = np.array([0.3, -0.7, 1.1], np.float32)
    steps = [Adam().step(gradient * np.float32(scale), Adam().start(3), 0.01)[0] for scale in (1, 50)]
    assert steps[0] == pytest.approx(steps[1], rel=1e-4)


def test_a_step_leaves_gradient_and_state_as_they_were():
    adam = Adam()
    gradient = np.array([1.0, 2.0], np.float32)
    _, state = adam.step(gradient, adam.start(2), 0.1)
    before = state.first.copy(), state.second.copy()
    adam.step(gradient, state, 0.1)
    assert gradient.tolist() == [1, 2]
    assert np.array_equal(state.first, before[0])
    assert np.array_equal(state.second, before[1])


def test_steps_and_moments_are_float32():
    step, state = Adam().step(np.ones(2, np.float32), Adam().start(2), 0.01)
    assert (step.dtype, state.first.dtype, state.second.dtype) == (np.float32,) * 3


def test_the_coefficients_are_adjustable():
    adam = Adam(beta1=0.5, beta2=0.75, epsilon=1e-3)
    plain = textbook.Adam(1)
    state = adam.start(1)
    for g in (0.5, -1.0, 2.0):
        step, state = adam.step(np.array([g], np.float32), state, 0.1)
        assert step == pytest.approx(plain.step([g], 0.1, 0.5, 0.75, 1e-3), rel=1e-5)
