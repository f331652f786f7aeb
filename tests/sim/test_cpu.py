"""The CPU simulator against a plain loop over `mj_step`, and its behaviour when the physics diverges."""

import logging
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.sim.cpu import CpuSimulator
from tests.envs.reference_worlds import ant_gather_xml

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
BAD_VALUES = {"huge": 1e12, "nan": np.nan, "infinite": np.inf}


def make_model(integrator="euler"):
    """The ant, whose contacts and limits make the solver's warm start matter."""
    model = mujoco.MjModel.from_xml_string(ant_gather_xml())
    model.opt.integrator = INTEGRATORS[integrator]
    return model


def disturb(simulator, rng):
    """Give every simulation a different state and different controls."""
    simulator.qpos[:, :3] += rng.uniform(-0.1, 0.1, (simulator.num_sims, 3))
    simulator.qvel[:] += rng.normal(0, 0.5, simulator.qvel.shape)
    simulator.ctrl[:] = rng.uniform(-30, 30, simulator.ctrl.shape)


@pytest.fixture
def records():
    """Records of the logger `shes.mujoco`; caplog misses them after a worker has turned off propagation."""
    kept = []
    handler = logging.Handler()
    handler.emit = kept.append
    logger = logging.getLogger("shes.mujoco")
    logger.addHandler(handler)
    yield kept
    logger.removeHandler(handler)


@pytest.fixture
def warning_handler():
    """Restore MuJoCo's warning handler after the test."""
    before = mujoco.get_mju_user_warning()
    yield
    mujoco.set_mju_user_warning(before)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_stepping_any_subset_equals_a_loop_over_mj_step(integrator):
    model, num_sims = make_model(integrator), 6
    rng = np.random.default_rng(7)
    simulator = CpuSimulator(model, num_sims)
    disturb(simulator, rng)
    loop = [mujoco.MjData(model) for _ in range(num_sims)]
    for i, data in enumerate(loop):
        data.qpos[:], data.qvel[:] = simulator.qpos[i], simulator.qvel[i]
    contacts = 0
    for _ in range(40):
        ids = np.flatnonzero(rng.random(num_sims) < 0.6)
        nstep = int(rng.integers(1, 6))
        simulator.ctrl[:] = rng.uniform(-30, 30, simulator.ctrl.shape)
        simulator.step(ids, nstep)
        for i in ids:
            loop[i].ctrl[:] = simulator.ctrl[i]
            for _ in range(nstep):
                mujoco.mj_step(model, loop[i])
            contacts += loop[i].ncon
        assert_array_equal(simulator.qpos, [data.qpos for data in loop])
        assert_array_equal(simulator.qvel, [data.qvel for data in loop])
    assert contacts > 0, "without contacts the solver had nothing to do"


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_reset_simulation_continues_like_a_fresh_mj_data(integrator):
    model = make_model(integrator)
    rng = np.random.default_rng(3)
    simulator = CpuSimulator(model, 3)
    disturb(simulator, rng)
    ids = np.arange(3)
    simulator.step(ids, 60)
    simulator.reset(np.array([1]))
    fresh = mujoco.MjData(model)
    disturb(simulator, rng)  # contacts that differ from those of the default pose: the solver's iterations show
    fresh.qpos[:], fresh.qvel[:] = simulator.qpos[1], simulator.qvel[1]
    for _ in range(50):
        simulator.ctrl[:] = rng.uniform(-30, 30, simulator.ctrl.shape)
        simulator.step(ids, 1)
        fresh.ctrl[:] = simulator.ctrl[1]
        mujoco.mj_step(model, fresh)
        assert_array_equal(simulator.qpos[1], fresh.qpos)
        assert_array_equal(simulator.qvel[1], fresh.qvel)


def test_a_reset_clears_the_controls():
    simulator = CpuSimulator(make_model(), 2)
    simulator.ctrl[:] = 30
    simulator.step(np.arange(2), 5)
    simulator.reset(np.array([0]))
    assert not simulator.ctrl[0].any()
    assert simulator.ctrl[1].all()


@pytest.mark.parametrize("field", ["qpos", "qvel"])
@pytest.mark.parametrize("bad", BAD_VALUES)
def test_only_the_simulation_that_blew_up_is_called_diverged(field, bad):
    rng = np.random.default_rng(5)
    calm, spoiled = (CpuSimulator(make_model(), 4) for _ in range(2))
    disturb(calm, rng)
    for name in ("qpos", "qvel", "ctrl"):
        getattr(spoiled, name)[:] = getattr(calm, name)
    getattr(spoiled, field)[2, 0] = BAD_VALUES[bad]
    others = [0, 1, 3]
    for _ in range(5):
        calm.step(np.arange(4), 5)
        spoiled.step(np.arange(4), 5)
        assert_array_equal(spoiled.diverged, [False, False, True, False])
        assert not calm.diverged.any()
        assert np.isfinite(spoiled.qpos).all()
        assert np.isfinite(spoiled.qvel).all()
        assert_array_equal(spoiled.qpos[others], calm.qpos[others])
        assert_array_equal(spoiled.qvel[others], calm.qvel[others])


def test_every_divergence_of_any_kind_is_noticed_until_the_reset():
    """MuJoCo's reset within a step zeroes the counters before it counts, so they read 1 after a divergence."""
    simulator, ids = CpuSimulator(make_model(), 2), np.arange(2)
    for field in ("qvel", "qvel", "ctrl", "qpos", "qvel"):
        getattr(simulator, field)[1, 0] = np.nan
        for stepped in (ids, ids[:1]):
            simulator.step(stepped, 5)
            assert_array_equal(simulator.diverged, [False, True])
        simulator.reset(ids)
        assert not simulator.diverged.any()


def test_physics_warnings_go_to_the_logger(records, warning_handler, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mujoco.set_mju_user_warning(None)
    simulator = CpuSimulator(make_model(), 2)
    simulator.qvel[1, 0] = 1e12
    simulator.step(np.arange(2), 5)
    assert [record.levelname for record in records] == ["WARNING"]
    assert "QVEL at DOF 0" in records[0].getMessage()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_every_divergence_is_logged(records, warning_handler):
    """MuJoCo does not repeat a warning whose counter is not 0."""
    mujoco.set_mju_user_warning(None)
    simulator = CpuSimulator(make_model(), 1)
    for _ in range(3):
        simulator.qvel[0, 0] = 1e12
        simulator.step(np.arange(1), 5)
        simulator.reset(np.arange(1))
    assert len(records) == 3


def test_a_divergence_prints_nothing_if_logging_is_not_configured(tmp_path):
    program = """
import mujoco, numpy as np
from shes.sim.cpu import CpuSimulator
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
)
simulator = CpuSimulator(model, 1)
simulator.qvel[0, 0] = 1e12
simulator.step(np.arange(1), 5)
assert simulator.diverged[0]
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=dict(os.environ), capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_warning_handler_that_the_caller_installed_stays(warning_handler):
    messages = []

    def handler(message):
        messages.append(message)

    mujoco.set_mju_user_warning(handler)
    simulator = CpuSimulator(make_model(), 1)
    assert mujoco.get_mju_user_warning() is handler
    simulator.qvel[0, 0] = 1e12
    simulator.step(np.arange(1), 5)
    assert len(messages) == 1


def test_a_whole_state_is_poses_velocities_warm_start_and_time():
    """All simulators share this layout, so a run may continue with another one. Controls are set before a step."""
    model = make_model()
    simulator = CpuSimulator(model, 1)
    disturb(simulator, np.random.default_rng(3))
    simulator.step(np.arange(1), 40)
    (kept,) = simulator.states(np.arange(1))
    data = mujoco.MjData(model)
    full = simulator._batch.state[0].copy()
    mujoco.mj_setState(model, data, full, mujoco.mjtState.mjSTATE_INTEGRATION)
    assert_array_equal(kept, [*data.qpos, *data.qvel, *data.qacc_warmstart, data.time])
    assert len(kept) == model.nq + 2 * model.nv + 1
    assert data.qacc_warmstart.any()
    assert data.time == pytest.approx(40 * model.opt.timestep)
    simulator.set_states(np.arange(1), kept[None])
    simulator.ctrl[:] = data.ctrl
    assert_array_equal(simulator._batch.state[0], full)  # nothing else that a step depends on
