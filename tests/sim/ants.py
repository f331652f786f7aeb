"""The ant that tests of simulators step: its contacts and limits make the solver's warm start matter."""

import mujoco

from tests.envs.reference_worlds import world

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}


def ant_model(integrator="euler"):
    model = world("gather", "ant")
    model.opt.integrator = INTEGRATORS[integrator]
    return model
