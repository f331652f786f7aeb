"""The Warp simulator on the CPU: the simulator contract, comparison with MuJoCo in C, and its own failure modes."""

import importlib.util
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shes.envs.bodies.robot import Robot, RobotOptions
from shes.envs.named_environments import ENVIRONMENTS
from shes.envs.tasks.flagrun import Flagrun
from shes.envs.tasks.task import TaskOptions
from shes.envs.worlds import INTEGRATORS
from shes.errors import ConfigError
from shes.sim.simulator import CpuSimulator
from shes.sim.warp import WarpSimulator, default_sizes
from tests.contracts import test_simulator_contract as contract
from tests.contracts.variants import VARIANTS
from tests.envs.robot_files import ASSETS, MOTOR, walker
from tests.messages import raises
from tests.sim.ants import ant_model

pytestmark = [
    pytest.mark.extras,
    pytest.mark.timeout(600),  # kernels are compiled the first time: up to a minute for a kind of model
    pytest.mark.skipif(
        importlib.util.find_spec("mujoco_warp") is None, reason="mujoco-warp is not installed: pip install 'shes[warp]'"
    ),
]

# The contract's tests, run here with the fixture `make` below.
globals().update({name: test for name, test in vars(contract).items() if name.startswith("test_")})
moving = contract.moving  # a fixture that they ask for

WarpCpu = partial(WarpSimulator, device="warp-cpu")
FIELDS = ("qpos", "qvel", "ctrl")
AUTO, SPARSE = mujoco.mjtJacobian.mjJAC_AUTO, mujoco.mjtJacobian.mjJAC_SPARSE
over_models = pytest.mark.parametrize(("name", "spec"), VARIANTS)


@pytest.fixture(params=["euler", "rk4"])
def make(request):
    """Return a function that makes a simulator of the ant, as the contract's tests expect."""
    model = ant_model(request.param)
    return lambda num_sims=contract.NUM_SIMS: WarpCpu(model, num_sims)


def task_model(name, spec, **options):
    environment = ENVIRONMENTS[name]
    return environment.task.build_world(environment.body(), environment.task.Options(spec=spec, **options)).compile()


@pytest.mark.parametrize("integrator", INTEGRATORS)
@over_models
def test_a_substep_where_nothing_touches_is_that_of_mujoco(name, spec, integrator):
    model, num_sims = task_model(name, spec, integrator=integrator), 8
    # In some worlds a block always touches the walls, and a default pose may lie beyond the limits.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    rng = np.random.default_rng(3)
    warp, cpu = WarpCpu(model, num_sims), CpuSimulator(model, num_sims)
    limit = model.actuator_ctrlrange[:, 1]
    for i in range(num_sims):
        mujoco.mj_integratePos(model, cpu.qpos[i], rng.normal(0, 0.5, model.nv), 1.0)
        cpu.qvel[i], cpu.ctrl[i] = rng.normal(0, 1, model.nv), rng.uniform(-limit, limit)
    for field in FIELDS:
        getattr(warp, field)[:] = getattr(cpu, field)
        getattr(cpu, field)[:] = getattr(warp, field)  # both start from the rounded state
    start = warp.qpos.copy()
    for simulator in (warp, cpu):
        simulator.step(np.arange(num_sims), 1)
    assert not (warp.qpos == start).all()
    assert_allclose(warp.qpos, cpu.qpos, atol=1e-5, rtol=0)
    assert_allclose(warp.qvel, cpu.qvel, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("field", FIELDS)
def test_a_bad_value_before_a_step_is_no_divergence_yet(field):
    simulator = WarpCpu(ant_model(), 2)
    getattr(simulator, field)[1, 0] = np.nan
    simulator.step(np.array([0]), 5)
    assert not simulator.diverged.any()
    assert np.isnan(getattr(simulator, field)[1, 0])
    simulator.step(np.array([1]), 5)
    assert_array_equal(simulator.diverged, [False, True])


@pytest.mark.parametrize("speed", [1e6, 1e8, 9e9])
def test_physics_that_blow_up_within_a_step_are_noticed(speed):
    """The velocity is still allowed; its effect in the step is not."""
    warp, cpu = (make(ant_model(), 3) for make in (WarpCpu, CpuSimulator))
    for simulator in (warp, cpu):
        simulator.qvel[1] = speed
        simulator.step(np.arange(3), 1)
        assert_array_equal(simulator.diverged, [False, True, False])
    assert_array_equal(warp.qpos[1], warp.model.qpos0.astype(np.float32))
    assert not warp.qvel[1].any()


@pytest.mark.parametrize("setting", ["nconmax", "njmax"])
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_a_buffer_that_is_too_small_is_told_a_size_that_does(setting, integrator):
    model, num_sims = ant_model(integrator), 4
    simulator = WarpCpu(model, num_sims, **{setting: 2})
    simulator.check_buffers()
    for _ in range(20):
        simulator.step(np.arange(num_sims), 5)
    with raises(ConfigError, f"overflowed: ... ({setting}) ... Set --{setting} to ... .") as error:
        simulator.check_buffers()
    size = int(str(error.value).rsplit(" ", 1)[1].rstrip("."))
    simulator = WarpCpu(model, num_sims, **{setting: size})
    for _ in range(20):
        simulator.step(np.arange(num_sims), 5)
    simulator.check_buffers()


@over_models
def test_a_task_needs_no_more_than_the_default_buffers(name, spec):
    """Robots thrown at walls and blocks in MuJoCo in C, which has as many contacts as mujoco-warp."""
    model = task_model(name, spec)
    nconmax, njmax = default_sizes(model)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    contacts = rows = 0
    for _ in range(4):
        mujoco.mj_resetData(model, data)
        data.qvel[:2] = rng.normal(0, 8, 2)
        for _ in range(100):
            data.ctrl[:] = rng.uniform(-30, 30, model.nu)
            mujoco.mj_step(model, data, 5)
            contacts, rows = max(contacts, data.ncon), max(rows, data.nefc)
    assert 2 * contacts <= nconmax
    assert 1.2 * rows <= njmax


@pytest.mark.parametrize("name", ["point-push", "point-fall"])
def test_a_block_between_walls_stands_where_it_stands_in_c(name):
    """Box-box contacts without a gap: the block moves by a margin and stays there."""
    model = task_model(name, "shes")
    warp, cpu = WarpCpu(model, 1), CpuSimulator(model, 1)
    for _ in range(40):
        for simulator in (warp, cpu):
            simulator.step(np.arange(1), 5)
    assert not warp.diverged.any()
    assert_allclose(warp.qpos, cpu.qpos, atol=1e-4)
    assert np.abs(warp.qpos[0, -2:]).max() < 0.03


def test_walks_of_two_seconds_are_those_of_c():
    """The median error is 2e-6 m; with mujoco-warp's own tangents of contacts it would be 0.2 m."""
    num_episodes, ids = 32, np.arange(32)
    places = []
    for simulator in (WarpCpu, CpuSimulator):
        task = ENVIRONMENTS["ant-gather"].make(num_episodes, TaskOptions(), simulator)
        task.reset(ids, ids.tolist())
        rng = np.random.default_rng(0)
        phase = rng.uniform(0, 2 * np.pi, (num_episodes, task.action_size))
        speed = rng.uniform(0.3, 1, (num_episodes, 1))
        for step in range(20):
            task.step(ids, task.control_limit * np.sin(speed * step + phase))
        places.append(task.position.copy())
    assert np.hypot(*places[1].T).max() > 0.3, "nobody walked"
    assert np.median(np.hypot(*(places[0] - places[1]).T)) < 1e-3


@pytest.mark.parametrize(("name", "integrator", "jacobian"), [("push", "euler", SPARSE), ("gather", "rk4", AUTO)])
def test_deterministic_steps_repeat_in_any_order_of_contacts(name, integrator, jacobian):
    from tests.sim.disorder import DisorderedSimulator

    model = task_model(f"ant-{name}", "shes", integrator=integrator)
    model.opt.jacobian, model.dof_frictionloss[6:14] = jacobian, 0.2

    def walk(simulator):
        rng = np.random.default_rng(0)
        simulator.qvel[:, :2] = rng.normal(0, 5, (4, 2))  # against walls and the block, too
        for _ in range(60):
            simulator.ctrl[:] = rng.uniform(-30, 30, (4, model.nu))
            simulator.step(np.arange(4), 5)
            yield np.hstack([simulator.qpos, simulator.qvel])

    expected = [list(walk(WarpCpu(model, 4, deterministic=each))) for each in (False, True)]
    found = [[list(walk(DisorderedSimulator(model, 4, seed, each))) for seed in (1, 2)] for each in (False, True)]
    assert [[np.array_equal(expected[i], states) for states in found[i]] for i in (0, 1)] == [[False] * 2, [True] * 2]
    assert_allclose(expected[0][:5], expected[1][:5], atol=1e-3)
    last = DisorderedSimulator(model, 4, 1, True)
    list(walk(last))
    contacts, of_their_rows = last.contacts_and_their_rows()
    assert contacts == of_their_rows != []
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    with raises(ConfigError, "need pyramidal friction cones ... Omit --deterministic"):
        WarpCpu(model, 4, deterministic=True)


def test_a_model_that_it_cannot_run_is_refused():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>"
        "<actuator><general joint='j' dyntype='integrator'/></actuator></mujoco>"
    )
    with raises(ConfigError, "state is qpos and qvel (2 numbers), got one of 3"):
        WarpCpu(model, 1)


def test_it_says_nothing_on_stdout(tmp_path):
    """By default Warp prints messages to stdout, where the command line prints its results."""
    program = """
import mujoco, numpy as np
from shes.sim.warp import WarpSimulator
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>'
)
simulator = WarpSimulator(model, 1, "warp-cpu", nconmax=1, njmax=1)
simulator.step(np.arange(1), 5)
assert simulator.qpos[0, 2] < 0
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (done.stdout, list(tmp_path.iterdir())) == ("", [])


@pytest.mark.parametrize("architecture", [80, 90])  # A100, H100
def test_the_kernels_compile_for_cards_that_are_not_there(tmp_path, architecture):
    import warp

    from shes.sim import warp_kernels

    paths = warp.compile_aot_module(warp_kernels, arch=architecture, module_dir=tmp_path, use_ptx=True)
    (code,) = [path for path in map(Path, paths) if path.suffix == ".ptx"]
    entries = re.findall(r"\.entry (\w+?)_[0-9a-f]+_cuda_kernel_forward", code.read_text())
    assert set(warp_kernels.__all__) == set(entries)


def test_a_robot_from_a_file_moves_as_in_mujoco():
    robot, ids, rng = Robot(RobotOptions(robot=str(ASSETS / "ant.xml"))), np.arange(2), np.random.default_rng(0)
    tasks = [Flagrun(robot, 2, Flagrun.Options(), simulator) for simulator in (CpuSimulator, WarpCpu)]
    for each in tasks:
        each.reset(ids, [1, 2])
    for _ in range(5):
        action = rng.uniform(-1, 1, (2, 8)).astype(np.float32)
        for each in tasks:
            each.step(ids, action)
            each.check_buffers()
    assert_allclose(*(each.sim.qpos for each in tasks), atol=1e-5)


@pytest.mark.parametrize(
    ("actuator", "before", "message"),
    [
        ('<position joint="{}" timeconst=".1"/>', "", "activations, delays or plasticity"),
        (MOTOR, '<option solver="PGS"/>', "mujoco-warp does not run this model: mjSOL_PGS is unsupported"),
    ],
)
def test_what_a_robot_needs_and_a_device_lacks_is_named(tmp_path, actuator, before, message):
    (tmp_path / "robot.xml").write_text(walker(4, actuator=actuator, before=before))
    robot = Robot(RobotOptions(robot=str(tmp_path / "robot.xml")))
    with raises(ConfigError, f"{message} ... Use --device cpu"):
        Flagrun(robot, 2, Flagrun.Options(), WarpCpu)
