"""Optimizers: what every one owes the update, and each one's numbers, by hand and by its paper."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.es.optimizers import OPTIMIZERS, SGD, Adam, ClipUp
from shes.options import make
from tests.es import textbook

every_name = pytest.mark.parametrize("name", OPTIMIZERS)
MOMENTUM = [SGD, ClipUp]


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
def test_the_start_is_one_zero_vector_for_each_slot(name):
    optimizer = OPTIMIZERS.find(name)()
    state = optimizer.start(4)
    assert state.steps == 0
    assert tuple(state.slots) == optimizer.slots
    assert all(slot.dtype == np.float32 and slot.tolist() == [0] * 4 for slot in state.slots.values())


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
    assert [state.steps for state in states] == [1, 2, 3]
    assert all(step.dtype == np.float32 and step.shape == (6,) for step in steps)
    assert all(tuple(state.slots) == optimizer.slots for state in states)
    assert all(slot.dtype == np.float32 for state in states for slot in state.slots.values())


@every_name
def test_the_first_step_goes_uphill(name):
    step, _ = OPTIMIZERS.find(name)().step(np.array([2, -3, 0], np.float32), OPTIMIZERS.find(name)().start(3), 0.01)
    assert np.sign(step).tolist() == [1, -1, 0]


@every_name
def test_no_gradient_at_the_start_is_no_step(name):
    step, state = OPTIMIZERS.find(name)().step(np.zeros(3, np.float32), OPTIMIZERS.find(name)().start(3), 0.01)
    assert step.tolist() == [0, 0, 0]
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


# ------------------------------------------------------------------------------------------------------------ ClipUp


def test_three_steps_of_clipup_are_those_worked_out_by_hand():
    # Rate 1, momentum 0.9, limit 2. The direction of (3, 4) is (0.6, 0.8): v1 is that, of length 1. v2 is 0.9 v1 plus
    # it, of length 1.9; v3 = 0.9 v2 plus it, of length 2.71, is clipped to 2.
    steps, states = _run(ClipUp(), [np.array([3, 4], np.float32)] * 3, rate=1)
    assert steps[0] == pytest.approx([0.6, 0.8])
    assert steps[1] == pytest.approx([1.14, 1.52])
    assert steps[2] == pytest.approx([1.2, 1.6])
    assert states[2].slots["velocity"].tobytes() == steps[2].tobytes()


@pytest.mark.parametrize(("momentum", "ratio"), [(0.9, 2.0), (0.0, 2.0), (0.5, 1.2), (0.99, 0.5)])
def test_many_steps_are_those_of_toklu_et_al(momentum, ratio):
    velocity = [0.0] * 6
    gradients = _gradients(60)
    for gradient, step in zip(
        gradients, _run(ClipUp(momentum=momentum, max_speed_ratio=ratio), gradients, rate=0.1)[0], strict=True
    ):
        length = math.sqrt(sum(float(g) ** 2 for g in gradient))
        velocity = [momentum * v + 0.1 * float(g) / length for v, g in zip(velocity, gradient, strict=True)]
        speed = math.sqrt(sum(v**2 for v in velocity))
        if speed > ratio * 0.1:
            velocity = [v * ratio * 0.1 / speed for v in velocity]
        assert step == pytest.approx(velocity, rel=1e-4, abs=1e-6)


@given(
    gradients=st.lists(
        st.lists(st.floats(-(2.0**120), 2.0**120, width=32), min_size=3, max_size=3), min_size=1, max_size=20
    ),
    rate=st.floats(1e-4, 10),
)
def test_clipup_never_exceeds_its_speed(gradients, rate):
    for step in _run(ClipUp(), [np.array(g, np.float32) for g in gradients], rate)[0]:
        assert math.sqrt(sum(float(x) ** 2 for x in step)) <= 2 * rate * (1 + 1e-6)


@pytest.mark.parametrize("scale", [1e-44, 1e-20, 1e30])
def test_the_gradients_length_does_not_matter_to_clipup(scale):
    step, _ = ClipUp().step(np.array([3, 4], np.float32) * np.float32(scale), ClipUp().start(2), 0.1)
    assert step == pytest.approx([0.06, 0.08], rel=0.3 if scale < 1e-40 else 1e-5)  # few digits are left that low


def test_a_gradient_of_zero_leaves_clipup_its_momentum():
    steps, _ = _run(ClipUp(), [np.array([3, 4], np.float32), np.zeros(2, np.float32)], rate=1)
    assert steps[1] == pytest.approx([0.54, 0.72])


# --------------------------------------------------------------------------------------------------------- the names


def test_momentum_concerns_sgd_and_clipup_only():
    assert make(OPTIMIZERS, "adam", {"momentum": 0.5}) == Adam()
    assert make(OPTIMIZERS, "sgd", {"momentum": 0.5}) == SGD(momentum=0.5)
    assert make(OPTIMIZERS, "clipup", {"momentum": 0.5}) == ClipUp(momentum=0.5, max_speed_ratio=2)


def test_an_unknown_optimizer_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"optimizer 'adma'.*'adam'\?.*--optimizer"):
        OPTIMIZERS.find("adma")()


@pytest.mark.parametrize("optimizer", MOMENTUM)
@pytest.mark.parametrize("momentum", [-0.1, 1, 2, math.nan])
def test_a_momentum_outside_zero_and_one_is_refused(optimizer, momentum):
    with pytest.raises(ConfigError, match=rf"at least 0 and less than 1, got {momentum}\. Set --momentum"):
        optimizer(momentum=momentum)


@pytest.mark.parametrize("ratio", [0, -1, math.inf, math.nan])
def test_a_speed_limit_that_is_not_positive_is_refused(ratio):
    with pytest.raises(ConfigError, match=rf"max_speed_ratio must be a positive number, got {ratio}"):
        ClipUp(max_speed_ratio=ratio)
