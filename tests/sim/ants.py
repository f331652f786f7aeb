"""The ant that tests of simulators step: its contacts and limits make the solver's warm start matter."""

from shes.envs.worlds import INTEGRATORS
from tests.envs.reference_worlds import world


def ant_model(integrator="euler"):
    model = world("gather", "ant")
    model.opt.integrator = INTEGRATORS[integrator]
    return model
