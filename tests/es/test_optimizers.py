"""Optimizers: what every one owes the update, and the numbers of each, by hand and by its paper."""

import numpy as np
import pytest

from shes.es.optimizers import OPTIMIZERS, SGD, Adam
from tests.es import textbook


def _gradients(count, dim=6):
    return np.random.default_rng(0).normal(size=(count, dim)).astype(np.float32)


def _run(optimizer, gradients, rate=0.01):
    """Return the steps [count][D] and the states after them."""
    state, steps, states = optimizer.start(len(gradients[0])), [], []
    for gradient in np.array(gradients, np.float32):
        for array in (gradient, *state.slots.values()):
            array.flags.writeable = False
        step, state = optimizer.step(gradient, state, rate)
        steps.append(step)
        states.append(state)
    return steps, states


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_a_step_is_pure_counted_and_of_float32(name):
    optimizer = OPTIMIZERS.find(name)()
    steps, states = _run(optimizer, _gradients(3))
    start = optimizer.start(6)
    assert not any(slot.any() for slot in start.slots.values())
    assert [state.steps for state in (start, *states)] == [0, 1, 2, 3]
    assert all(tuple(state.slots) == optimizer.slots for state in (start, *states))
    arrays = [*steps, *(slot for state in (start, *states) for slot in state.slots.values())]
    assert all((array.dtype, array.shape) == (np.float32, (6,)) for array in arrays)
    steps[-1][:] = 99  # the step belongs to the caller
    assert not any((slot == 99).any() for slot in states[-1].slots.values())


@pytest.mark.parametrize("coefficients", [(0.9, 0.999, 1e-8), (0.5, 0.75, 1e-3)])
def test_many_steps_are_those_of_kingma_and_ba(coefficients):
    gradients, plain = _gradients(50), textbook.Adam(6)
    optimizer = Adam(**dict(zip(("beta1", "beta2", "epsilon"), coefficients, strict=True)))
    for gradient, step in zip(gradients, _run(optimizer, gradients, rate=0.1)[0], strict=True):
        assert step == pytest.approx(plain.step(gradient.tolist(), 0.1, *coefficients), rel=1e-4, abs=1e-7)
    assert Adam() == Adam(beta1=0.9, beta2=0.999, epsilon=1e-8)


@pytest.mark.parametrize("momentum", [0.0, 0.5, 0.9, 0.99])
def test_sgd_follows_a_fading_mean_of_the_gradients(momentum):
    gradients = _gradients(30)
    optimizer = SGD() if momentum == 0.9 else SGD(momentum=momentum)
    for t, step in enumerate(_run(optimizer, gradients, rate=0.3)[0]):
        mean = sum((1 - momentum) * momentum ** (t - s) * gradients[s].astype(float) for s in range(t + 1))
        assert step == pytest.approx(0.3 * mean, rel=1e-4, abs=1e-6)
