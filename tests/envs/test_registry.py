"""Environments by name, and the options of a task."""

import numpy as np
import pytest

from shes.envs.ant import Ant
from shes.envs.body import Body
from shes.envs.gather import Gather
from shes.envs.point import Point
from shes.envs.registry import ENVIRONMENTS, check_name, make_task
from shes.envs.task import Task, TaskOptions
from shes.errors import ConfigError, UnknownNameError
from shes.sim.cpu import CpuSimulator


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_name_is_its_body_and_its_task(name):
    body, task = ENVIRONMENTS[name]
    assert issubclass(body, Body)
    assert issubclass(task, Task)
    assert name == f"{body.name}-{task.name}"


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_name_makes_its_task(name):
    check_name(name)
    task = make_task(name, 2)
    body, kind = ENVIRONMENTS[name]
    assert type(task) is kind
    assert type(task.body) is body
    assert task.num_episodes == 2
    assert task.options == TaskOptions()


def test_gather_is_there_for_ant_and_point():
    assert ENVIRONMENTS["ant-gather"] == (Ant, Gather)
    assert ENVIRONMENTS["point-gather"] == (Point, Gather)


@pytest.mark.parametrize("call", [check_name, lambda name: make_task(name, 1)])
@pytest.mark.parametrize(("wrong", "right"), [("ant-gathr", "ant-gather"), ("pointgather", "point-gather")])
def test_an_unknown_environment_is_refused_with_the_nearest_name(call, wrong, right):
    with pytest.raises(UnknownNameError, match=rf"unknown environment '{wrong}'. Did you mean '{right}'\?") as caught:
        call(wrong)
    for name in ENVIRONMENTS:
        assert name in str(caught.value)
    assert "shes envs" in str(caught.value)


def test_a_name_unlike_any_other_gets_no_suggestion():
    with pytest.raises(UnknownNameError, match=r"unknown environment 'zzz'. Known: ant-gather, "):
        check_name("zzz")


def test_an_unknown_integrator_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownNameError, match=r"unknown integrator 'Euler'. Did you mean 'euler'\?.*--integrator"):
        TaskOptions(integrator="Euler")


@pytest.mark.parametrize("noise", [-0.1, -1e-9, 1.0, 5.0, np.nan, np.inf])
def test_reset_noise_outside_0_to_1_is_refused(noise):
    with pytest.raises(ConfigError, match=rf"reset_noise must be in \[0, 1\), got {noise}. Set --reset-noise"):
        TaskOptions(reset_noise=noise)


def test_options_default_to_the_specification():
    options = TaskOptions()
    assert options.integrator == "euler"
    assert options.reset_noise == 0.1
    assert not options.evaluation


def test_a_task_uses_the_simulator_it_is_given():
    made = []

    def simulator(model, num_sims):
        made.append(CpuSimulator(model, num_sims))
        return made[-1]

    task = make_task("point-gather", 3, simulator=simulator)
    assert [task.sim] == made
    assert task.sim.num_sims == 3
