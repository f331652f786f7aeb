"""The CPU simulator against a plain loop over `mj_step`, and its behaviour when the physics diverges."""

import logging

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.worlds import INTEGRATORS
from shes.sim.simulator import CpuSimulator
from tests.sim.ants import ant_model


@pytest.fixture
def records():
    """Records of the logger `shes.mujoco`; caplog misses them after a worker has turned off propagation."""
    kept = []
    handler = logging.Handler()
    handler.emit = kept.append
    logger, before = logging.getLogger("shes.mujoco"), mujoco.get_mju_user_warning()
    logger.addHandler(handler)
    mujoco.set_mju_user_warning(None)
    yield kept
    logger.removeHandler(handler)
    mujoco.set_mju_user_warning(before)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_stepping_any_subset_equals_a_loop_over_mj_step(integrator):
    """Also after resets. A whole state is poses, velocities, warm start and time, as every simulator has it."""
    model, num_sims = ant_model(integrator), 6
    rng = np.random.default_rng(7)
    simulator = CpuSimulator(model, num_sims)
    loop, contacts = [mujoco.MjData(model) for _ in range(num_sims)], 0
    for turn in range(60):
        if turn % 30 == 0:
            anew = np.arange(num_sims) if turn == 0 else np.array([1, 4])
            simulator.reset(anew)
            simulator.qpos[:, :3] += rng.uniform(-0.1, 0.1, (num_sims, 3))
            simulator.qvel[:] = rng.normal(0, 0.5, simulator.qvel.shape)
            for i, data in enumerate(loop):
                if i in anew:
                    mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[:] = simulator.qpos[i], simulator.qvel[i]
        ids = np.flatnonzero(rng.random(num_sims) < 0.6)
        nstep = int(rng.integers(1, 6))
        simulator.ctrl[:] = rng.uniform(-30, 30, simulator.ctrl.shape)
        simulator.step(ids, nstep)
        for i in ids:
            loop[i].ctrl[:] = simulator.ctrl[i]
            mujoco.mj_step(model, loop[i], nstep)
            contacts += loop[i].ncon
        whole = [[*data.qpos, *data.qvel, *data.qacc_warmstart, data.time] for data in loop]
        assert_array_equal(simulator.states(np.arange(num_sims)), whole)
    assert contacts > 0, "without contacts the solver had nothing to do"


def test_every_divergence_goes_to_the_logger_alone(records, capfd, tmp_path, monkeypatch):
    """MuJoCo does not repeat a warning whose counter is not 0, and writes MUJOCO_LOG.TXT."""
    monkeypatch.chdir(tmp_path)
    simulator = CpuSimulator(ant_model(), 1)
    for _ in range(3):
        simulator.qvel[0, 0] = 1e12
        simulator.step(np.arange(1), 5)
        simulator.reset(np.arange(1))
    assert [record.levelname for record in records] == ["WARNING"] * 3
    assert "QVEL at DOF 0" in records[0].getMessage()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_warning_handler_that_the_caller_installed_stays(records):
    messages = []
    mujoco.set_mju_user_warning(messages.append)
    simulator = CpuSimulator(ant_model(), 1)
    simulator.qvel[0, 0] = 1e12
    simulator.step(np.arange(1), 5)
    assert len(messages) == 1
    assert records == []
