"""The contract of simulators. A new simulator is one line in `SIMULATORS`."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.sim.simulator import CpuSimulator, Simulator
from tests.sim.ants import ant_model

SIMULATORS = {"cpu": CpuSimulator}
NUM_SIMS = 5
ALL = np.arange(NUM_SIMS)


@pytest.fixture(params=SIMULATORS)
def make(request):
    """Return a function that makes a simulator of the ant, NUM_SIMS copies of it unless told otherwise."""
    model = ant_model()
    return lambda num_sims=NUM_SIMS: SIMULATORS[request.param](model, num_sims)


def host(array):
    """Return a copy as a NumPy array."""
    return np.array(array.get() if hasattr(array, "get") else array)


def state(simulator):
    return np.concatenate([host(simulator.qpos), host(simulator.qvel)], axis=1)


def kick(simulator, seed=0):
    """Give every simulation a different velocity and different controls."""
    rng = np.random.default_rng(seed)
    simulator.qvel[:] = simulator.xp.asarray(rng.normal(0, 0.5, simulator.qvel.shape))
    simulator.ctrl[:] = simulator.xp.asarray(rng.uniform(-30, 30, simulator.ctrl.shape))


def test_a_new_simulator_stands_in_the_default_state(make):
    simulator = make()
    model = simulator.model
    assert isinstance(simulator, Simulator)
    assert simulator.num_sims == NUM_SIMS
    assert_array_equal(host(simulator.qpos), np.tile(model.qpos0, (NUM_SIMS, 1)))
    assert_array_equal(host(simulator.qvel), np.zeros((NUM_SIMS, model.nv)))
    assert_array_equal(host(simulator.ctrl), np.zeros((NUM_SIMS, model.nu)))
    assert_array_equal(host(simulator.diverged), np.zeros(NUM_SIMS, np.bool_))
    assert simulator.diverged.dtype == np.bool_


def test_what_is_written_is_the_state_at_the_next_step(make):
    simulator = make()
    qpos, qvel = simulator.qpos, simulator.qvel
    simulator.qpos[2, 0] = 5.0
    simulator.qvel[2, 0] = 1.0
    simulator.ctrl[3] = 30
    simulator.step(ALL, 1)
    joints = host(simulator.qpos)[:, 7:]
    assert np.abs(joints[3] - joints[0]).min() > 1e-4
    assert host(simulator.qpos)[2, 0] == pytest.approx(5.02, abs=5e-3)
    assert host(simulator.qpos)[1, 0] == pytest.approx(0.0, abs=5e-3)
    assert (simulator.qpos is qpos, simulator.qvel is qvel) == (True, True)  # they are live


def test_a_simulation_depends_neither_on_others_nor_on_calls(make):
    together, apart, one = make(), make(), make(1)
    for simulator in (together, apart):
        kick(simulator)
    one.qvel[:], one.ctrl[:] = together.qvel[3:4], together.ctrl[3:4]
    for _ in range(8):
        together.step(ALL, 5)
        for ids in ([1, 3], [4], [0, 2]):
            apart.step(np.array(ids), 5)
        for _ in range(5):
            one.step(np.arange(1), 1)
        assert_array_equal(state(together), state(apart))
        assert_array_equal(state(together)[3], state(one)[0])


def test_a_reset_simulation_cannot_be_told_from_a_new_one(make):
    used, new = make(), make()
    kick(used, seed=1)
    used.step(ALL, 60)
    before = state(used)
    used.reset(np.array([1, 4]))
    assert_array_equal(state(used)[[1, 4]], state(new)[[1, 4]])
    assert_array_equal(state(used)[[0, 2, 3]], before[[0, 2, 3]])
    assert not host(used.ctrl)[[1, 4]].any()
    used.reset(ALL)
    for simulator in (used, new):
        kick(simulator, seed=2)
    for _ in range(20):
        used.step(ALL, 5)
        new.step(ALL, 5)
        assert_array_equal(state(used), state(new))


@pytest.mark.parametrize(
    ("field", "bad"),
    [*product(["qpos", "qvel"], [1e12, np.nan, np.inf]), ("ctrl", np.nan)],  # a large control is cut
)
def test_only_the_simulation_that_blew_up_diverges(make, field, bad):
    calm, spoiled = make(), make()
    kick(calm)
    kick(spoiled)
    others = [0, 1, 2, 4]
    for _ in range(2):  # a second time, too, after a reset
        getattr(spoiled, field)[3, 0] = bad
        for ids in (ALL, ALL, np.array(others)):
            calm.step(ids, 5)
            spoiled.step(ids, 5)
            spoiled.ctrl[3] = 0
            assert_array_equal(host(spoiled.diverged), ALL == 3)
            assert np.isfinite(state(spoiled)).all()
            assert_array_equal(state(spoiled)[others], state(calm)[others])
        spoiled.reset(np.array([3]))
        assert not host(calm.diverged).any()
        assert not host(spoiled.diverged).any()
    spoiled.step(ALL, 5)
    assert not host(spoiled.diverged).any()


def go_on(simulator, ids, steps=20):
    """Step simulations `ids` with the same controls; return their states after each step [steps, ids, S]."""
    found, rng = [], np.random.default_rng(3)
    for _ in range(steps):
        simulator.ctrl[:] = simulator.xp.asarray(rng.uniform(-30, 30, simulator.model.nu))
        simulator.step(np.array(ids), 5)
        found.append(state(simulator)[ids])
    return np.array(found)


@pytest.fixture
def moving(make):
    """A simulator in motion, with contacts, whose simulations all differ."""
    simulator = make()
    kick(simulator)
    simulator.step(ALL, 40)
    kick(simulator, seed=5)
    simulator.step(ALL, 5)
    assert len({row.tobytes() for row in state(simulator)}) == NUM_SIMS
    return simulator


def test_whole_states_are_copied_rows_in_numpys_arrays(moving):
    states = moving.states(ALL)
    kept = states.copy()
    assert (type(states), states.dtype) == (np.ndarray, np.float64)
    assert states.shape == (NUM_SIMS, moving.model.nq + 2 * moving.model.nv + 1)
    assert_array_equal(moving.states(np.array([3, 1])), states[[3, 1]])
    moving.step(ALL, 5)
    assert_array_equal(states, kept)
    moving.set_states(ALL, states)
    states[:] = 0
    assert_array_equal(moving.states(ALL), kept)
    moving.step(ALL, 5)
    assert not states.any()


def test_a_state_put_elsewhere_goes_on_with_the_same_bits(make, moving):
    """Also in another row of another simulator of the same model, of any size and history."""
    one, used = make(1), make()
    kick(used, seed=8)
    used.step(ALL, 30)
    states = moving.states(ALL)
    one.set_states(np.array([0]), states[3:4])
    used.set_states(ALL[::-1], states)
    assert_array_equal(used.states(ALL[::-1]), states)
    wanted = go_on(moving, ALL)
    assert_array_equal(go_on(used, ALL)[:, ::-1], wanted)
    assert_array_equal(go_on(one, [0])[:, 0], wanted[:, 3])
    assert len({bits.tobytes() for step in wanted for bits in step}) == 20 * NUM_SIMS


def test_putting_states_moves_only_the_simulations_asked_for(moving):
    before = moving.states(ALL)
    moving.set_states(np.array([4, 0]), before[[1, 3]])
    assert_array_equal(moving.states(ALL), before[[3, 1, 2, 3, 1]])
    found = go_on(moving, ALL)
    assert_array_equal(found[:, [4, 0]], found[:, [1, 3]])


def test_a_simulation_put_into_a_state_is_no_longer_diverged(moving):
    states = moving.states(np.array([0]))
    for _ in range(2):
        moving.qvel[3, 0] = 1e12
        moving.step(ALL, 5)
        assert_array_equal(host(moving.diverged), ALL == 3)
        moving.set_states(np.array([3]), states)
        assert not host(moving.diverged).any()
