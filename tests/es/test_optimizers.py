"""Optimizers: what every one owes the update, and each one's numbers, by hand and by its paper."""

import numpy as np
import pytest

from shes.errors import UnknownNameError
from shes.es.optimizers import OPTIMIZERS, SGD, Adam
from tests.es import textbook

every_name = pytest.mark.parametrize("name", OPTIMIZERS)


def _gradients(count, dim=6, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=dim).astype(np.float32) for _ in range(count)]


def _run(optimizer, gradients, rate=0.01):
    """Return the steps [count][D] and the states after them."""
    state, steps, states = optimizer.start(len(gradients[0])), [], []
    for gradient in gradients:
        step, state = optimizer.step(gradient, state, rate)
        steps.append(step)
        states.append(state)
    return steps, states


# ---------------------------------------------------------------------------------------- what every optimizer owes


@every_name
def test_a_step_leaves_gradient_and_state_as_they_were(name):
    optimizer = OPTIMIZERS.find(name)()
    gradients = _gradients(3)
    _, states = _run(optimizer, gradients[:2])
    before = {slot: values.copy() for slot, values in states[-1].slots.items()}
    gradient = gradients[2].copy()
    step, state = optimizer.step(gradient, states[-1], 0.1)
    step[:] = 99  # what a caller does with the step is no concern of the state
    after = {slot: values.copy() for slot, values in state.slots.items()}
    assert gradient.tobytes() == gradients[2].tobytes()
    assert states[-1].steps == 2
    for slot, values in before.items():
        assert states[-1].slots[slot].tobytes() == values.tobytes()
        assert not np.any(after[slot] == 99)


@every_name
def test_the_same_gradients_give_the_same_bits(name):
    first, second = (_run(OPTIMIZERS.find(name)(), _gradients(20)) for _ in range(2))
    assert [step.tobytes() for step in first[0]] == [step.tobytes() for step in second[0]]


@every_name
def test_steps_are_counted_and_everything_stays_float32(name):
    optimizer = OPTIMIZERS.find(name)()
    steps, states = _run(optimizer, _gradients(3))
    start = optimizer.start(6)
    assert all(slot.tolist() == [0] * 6 for slot in start.slots.values())
    assert [state.steps for state in (start, *states)] == [0, 1, 2, 3]
    assert all(step.dtype == np.float32 and step.shape == (6,) for step in steps)
    assert all(tuple(state.slots) == optimizer.slots for state in (start, *states))
    assert all(slot.dtype == np.float32 for state in (start, *states) for slot in state.slots.values())


@every_name
@pytest.mark.parametrize("gradient", [[2, -3, 0], [0, 0, 0]])
def test_the_first_step_goes_uphill(name, gradient):
    optimizer = OPTIMIZERS.find(name)()
    step, state = optimizer.step(np.array(gradient, np.float32), optimizer.start(3), 0.01)
    assert np.sign(step).tolist() == np.sign(gradient).tolist()
    assert state.steps == 1


@every_name
def test_it_climbs_a_quadratic(name):
    optimizer = OPTIMIZERS.find(name)()
    optimum = np.array([1, -2, 0.5, 3], np.float32)
    theta, state = np.zeros(4, np.float32), optimizer.start(4)
    for _ in range(1500):
        step, state = optimizer.step(2 * (optimum - theta), state, 0.02)
        theta += step
    assert theta == pytest.approx(optimum, abs=0.1)


# -------------------------------------------------------------------------------------------------------------- Adam


def test_the_first_two_steps_are_those_worked_out_by_hand():
    # Gradients 0.5 and -0.25, rate 0.1. m1 = 0.05, v1 = 0.00025, m^ = 0.5, v^ = 0.25: step 0.1 * 0.5 / 0.5.
    # m2 = 0.045 - 0.025 = 0.02, v2 = 0.00024975 + 0.0000625 = 0.00031225, m^ = 0.02 / 0.19, v^ = 0.00031225 / 0.001999:
    # step 0.1 * 0.1052632 / 0.3952249.
    steps, states = _run(Adam(), [np.array([g], np.float32) for g in (0.5, -0.25)], rate=0.1)
    assert [step[0] for step in steps] == [pytest.approx(0.1, rel=1e-6), pytest.approx(0.0266337, rel=1e-5)]
    assert [state.slots["first"][0] for state in states] == pytest.approx([0.05, 0.02])
    assert [state.slots["second"][0] for state in states] == pytest.approx([0.00025, 0.00031225])


def test_many_steps_are_those_of_kingma_and_ba():
    gradients, plain = _gradients(50), textbook.Adam(6)
    for gradient, step in zip(gradients, _run(Adam(), gradients)[0], strict=True):
        assert step == pytest.approx(plain.step(gradient.tolist(), 0.01), rel=1e-4, abs=1e-8)


def test_the_first_step_of_adam_does_not_depend_on_the_gradients_scale():
    gradient = np.array([0.3, -0.7, 1.1], np.float32)
    steps = [Adam().step(gradient * np.float32(scale), Adam().start(3), 0.01)[0] for scale in (1, 50)]
    assert steps[0] == pytest.approx(steps[1], rel=1e-4)


def test_the_coefficients_of_adam_are_adjustable():
    plain = textbook.Adam(1)
    gradients = [np.array([g], np.float32) for g in (0.5, -1.0, 2.0)]
    for gradient, step in zip(
        gradients, _run(Adam(beta1=0.5, beta2=0.75, epsilon=1e-3), gradients, rate=0.1)[0], strict=True
    ):
        assert step == pytest.approx(plain.step(gradient.tolist(), 0.1, 0.5, 0.75, 1e-3), rel=1e-5)


# --------------------------------------------------------------------------------------------------------------- SGD


def test_two_steps_of_sgd_are_those_worked_out_by_hand():
    # Momentum 0.9, rate 0.5: v1 = 0.1 * 2 = 0.2, step 0.1; v2 = 0.18 - 0.1 = 0.08, step 0.04.
    steps, states = _run(SGD(), [np.array([g], np.float32) for g in (2, -1)], rate=0.5)
    assert [step[0] for step in steps] == pytest.approx([0.1, 0.04])
    assert [state.slots["velocity"][0] for state in states] == pytest.approx([0.2, 0.08])


@pytest.mark.parametrize("momentum", [0.0, 0.5, 0.9, 0.99])
def test_a_step_of_sgd_is_the_rate_times_a_fading_mean_of_the_gradients(momentum):
    gradients = _gradients(30)
    for t, step in enumerate(_run(SGD(momentum=momentum), gradients, rate=0.3)[0]):
        mean = sum((1 - momentum) * momentum ** (t - s) * gradients[s].astype(float) for s in range(t + 1))
        assert step == pytest.approx(0.3 * mean, rel=1e-4, abs=1e-6)


# --------------------------------------------------------------------------------------------------------- the names


def test_an_unknown_optimizer_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"optimizer 'adma'.*'adam'\?.*--optimizer"):
        OPTIMIZERS.find("adma")()
