"""The contract of simulators. A new simulator is one line in `SIMULATORS`."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.sim.cpu import CpuSimulator
from shes.sim.simulator import Simulator
from tests.envs.reference_worlds import ant_gather_xml

SIMULATORS = {"cpu": CpuSimulator}
NUM_SIMS = 5
ALL = np.arange(NUM_SIMS)


@pytest.fixture(params=SIMULATORS)
def make(request):
    """Return a new simulator of the ant, NUM_SIMS copies of it unless told otherwise."""
    model = mujoco.MjModel.from_xml_string(ant_gather_xml())

    def build(num_sims=NUM_SIMS):
        return SIMULATORS[request.param](model, num_sims)

    return build


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


def test_arrays_have_one_row_per_simulation(make):
    simulator = make()
    model = simulator.model
    assert isinstance(simulator, Simulator)
    assert simulator.num_sims == NUM_SIMS
    assert simulator.qpos.shape == (NUM_SIMS, model.nq)
    assert simulator.qvel.shape == (NUM_SIMS, model.nv)
    assert simulator.ctrl.shape == (NUM_SIMS, model.nu)
    assert simulator.diverged.shape == (NUM_SIMS,)
    assert simulator.diverged.dtype == np.bool_


def test_a_new_simulator_stands_in_the_default_state(make):
    simulator = make()
    assert_array_equal(host(simulator.qpos), np.tile(simulator.model.qpos0, (NUM_SIMS, 1)))
    assert not host(simulator.qvel).any()
    assert not host(simulator.ctrl).any()
    assert not host(simulator.diverged).any()


def test_arrays_are_live(make):
    simulator = make()
    arrays = simulator.qpos, simulator.qvel
    kick(simulator)
    before = [host(array) for array in arrays]
    simulator.step(ALL, 5)
    assert simulator.qpos is arrays[0]
    assert simulator.qvel is arrays[1]
    for array, old in zip(arrays, before, strict=True):
        assert (host(array) != old).any(axis=1).all()


def test_what_is_written_is_the_state_at_the_next_step(make):
    simulator = make()
    simulator.qpos[2, 0] = 5.0
    simulator.qvel[2, 0] = 1.0
    simulator.ctrl[3] = 30
    simulator.step(ALL, 1)
    joints = host(simulator.qpos)[:, 7:]
    assert np.abs(joints[3] - joints[0]).min() > 1e-4
    assert host(simulator.qpos)[2, 0] == pytest.approx(5.02, abs=5e-3)
    assert host(simulator.qpos)[1, 0] == pytest.approx(0.0, abs=5e-3)


@pytest.mark.parametrize("ids", [[], [0], [4], [1, 3], [0, 1, 2, 3, 4]])
def test_simulations_that_are_not_stepped_do_not_move(make, ids):
    simulator = make()
    kick(simulator)
    before = state(simulator)
    simulator.step(np.array(ids, dtype=np.int64), 5)
    has_moved = (state(simulator) != before).any(axis=1)
    assert_array_equal(has_moved, np.isin(ALL, ids))


def test_a_simulation_does_not_depend_on_which_others_are_stepped(make):
    together, apart = make(), make()
    for simulator in (together, apart):
        kick(simulator)
    together.step(ALL, 5)
    for ids in ([1, 3], [4], [0, 2]):
        apart.step(np.array(ids), 5)
    assert_array_equal(state(together), state(apart))


def test_a_simulation_does_not_depend_on_how_many_there_are(make):
    many, one = make(), make(1)
    kick(many)
    one.qvel[:], one.ctrl[:] = many.qvel[3:4], many.ctrl[3:4]
    for _ in range(20):
        many.step(ALL, 5)
        one.step(np.arange(1), 5)
    assert_array_equal(state(many)[3], state(one)[0])


def test_five_steps_in_one_call_equal_five_calls(make):
    once, often = make(), make()
    for simulator in (once, often):
        kick(simulator)
    once.step(ALL, 5)
    for _ in range(5):
        often.step(ALL, 1)
    assert_array_equal(state(once), state(often))


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


def test_a_diverged_simulation_stays_finite_and_is_marked_alone(make):
    simulator = make()
    for _ in range(3):
        simulator.qvel[3, 0] = 1e12
        simulator.step(ALL, 5)
        assert_array_equal(host(simulator.diverged), ALL == 3)
        assert np.isfinite(state(simulator)).all()
        simulator.reset(np.array([3]))
        assert not host(simulator.diverged).any()
        simulator.step(ALL, 5)
        assert not host(simulator.diverged).any()


# Whole states.


def controls(simulator, steps, seed=3):
    """Return controls [steps, nu] for every simulation."""
    rng = np.random.default_rng(seed)
    return simulator.xp.asarray(rng.uniform(-30, 30, (steps, simulator.model.nu)))


def go_on(simulator, ids, steps=20):
    """Step simulations `ids` with the same controls; return their states after each step [steps, ids, S]."""
    found = []
    for control in controls(simulator, steps):
        simulator.ctrl[:] = control
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


def test_whole_states_are_rows_of_one_size_in_numpys_arrays(moving):
    states = moving.states(np.array([3, 1]))
    assert type(states) is np.ndarray
    assert states.dtype == np.float64
    assert states.shape == (2, moving.model.nq + 2 * moving.model.nv + 1)
    assert np.array_equal(states, moving.states(ALL)[[3, 1]])


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


def test_states_are_copies_there_and_back(moving):
    states = moving.states(ALL)
    kept = states.copy()
    moving.step(ALL, 5)
    assert_array_equal(states, kept)
    moving.set_states(ALL, states)
    states[:] = 0
    assert_array_equal(moving.states(ALL), kept)
    moving.step(ALL, 5)
    assert_array_equal(states, 0 * kept)


def test_a_simulation_put_into_a_state_is_no_longer_diverged(moving):
    states = moving.states(np.array([0]))
    for _ in range(2):
        moving.qvel[3, 0] = 1e12
        moving.step(ALL, 5)
        assert_array_equal(host(moving.diverged), ALL == 3)
        moving.set_states(np.array([3]), states)
        assert not host(moving.diverged).any()
        moving.step(ALL, 5)
        assert not host(moving.diverged).any()


def test_the_solvers_warm_start_is_part_of_a_state(make, moving):
    """Continuing from poses, velocities and controls alone is not bit-identical."""
    cold, warm = make(), make()
    for name in ("qpos", "qvel"):
        getattr(cold, name)[:] = cold.xp.asarray(host(getattr(moving, name)))
    warm.set_states(ALL, moving.states(ALL))
    wanted = go_on(moving, ALL, steps=3)
    assert_array_equal(go_on(warm, ALL, steps=3), wanted)
    assert (go_on(cold, ALL, steps=3) != wanted).any()
