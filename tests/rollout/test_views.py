"""Views: what levels see, against rotation matrices written out and the names that environments give."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shes.agents.views import ColumnsView
from shes.envs.bodies.ant import Ant
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.named_environments import ENVIRONMENTS, EXTERNAL_ENVIRONMENTS, register_external
from shes.envs.worlds import empty_world
from shes.errors import ConfigError
from shes.runs.build import build_algorithm, build_environment, build_options
from shes.runs.make_config import make_config
from tests.contracts.variants import VARIANTS
from tests.messages import raises

ROWS = 6


def tumbled(seed=0):
    """Return poses [N, 15] and velocities [N, 14] of ants that lie in any way."""
    rng = np.random.default_rng(seed)
    qpos, qvel = rng.normal(0, 2, (ROWS, 15)), rng.normal(0, 3, (ROWS, 14))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos, qvel


def view_of(body, qpos, qvel):
    out = np.full((len(qpos), len(body.egocentric)), np.nan)
    body.write_egocentric(qpos, qvel, body.frame_angle(qpos), out)
    return out


def test_every_value_of_the_ants_view_is_what_its_name_says():
    spec = empty_world("ant", "euler")
    Ant().add_to(spec)
    (qpos, qvel), model = tumbled(), spec.compile()
    seen = view_of(Ant(), qpos, qvel)
    for row in range(ROWS):
        matrix = Rotation.from_quat(qpos[row, 3:7], scalar_first=True).as_matrix()
        # The angle about the vertical after which what is left of the rotation is a tilt about a level axis.
        angle = np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])
        back = Rotation.from_rotvec([0, 0, -angle]).as_matrix()
        assert (back @ matrix)[1, 0] == pytest.approx((back @ matrix)[0, 1], abs=1e-12)
        tilt, velocity = back @ matrix @ [0, 0, 1], back @ qvel[row, :3]
        expected = {
            "torso_z": qpos[row, 2],
            "tilt_ahead": tilt[0],
            "tilt_left": tilt[1],
            **{f"velocity_{name}": velocity[i] for i, name in enumerate(("ahead", "left", "up"))},
            **{f"torso_w{axis}": qvel[row, 3 + i] for i, axis in enumerate("xyz")},
        }
        for joint in range(1, model.njnt):
            name = model.joint(joint).name
            expected[name] = qpos[row, model.jnt_qposadr[joint]]
            expected[f"{name}_velocity"] = qvel[row, model.jnt_dofadr[joint]]
        assert len(expected) == model.nq + model.nv - 4  # without x, y, yaw, and one of a quaternion's four
        names = [each.name for each in Ant.egocentric]
        assert dict(zip(names, seen[row], strict=True)) == pytest.approx(expected, abs=1e-12)


def test_points_see_velocities_and_an_upright_ant_its_heading():
    (flat, flat_v), (falling, falling_v) = (np.random.default_rng(3).normal(size=(2, 4, size)) for size in (2, 3))
    assert view_of(Point(), flat, flat_v).tolist() == flat_v.tolist()
    assert view_of(FallingPoint(), falling, falling_v).tolist() == np.hstack([falling[:, 2:], falling_v]).tolist()
    assert [each.name for each in Point.egocentric] == ["torso_vx", "torso_vy"]
    assert [each.name for each in FallingPoint.egocentric] == ["torso_z", "torso_vx", "torso_vy", "torso_vz"]
    assert not Point().frame_angle(flat).any()
    qpos, angles = tumbled(2)[0], np.linspace(-3, 3, ROWS)  # an upright ant's frame is its heading
    qpos[:, 3:7] = Rotation.from_rotvec(np.outer(angles, [0, 0, 1])).as_quat(scalar_first=True)
    assert Ant().frame_angle(qpos) == pytest.approx(angles)
    assert np.cos(Ant().frame_angle(-qpos) - angles) == pytest.approx(1)  # the other quaternion of the same pose


def moving(config, rows):
    """Return a task whose robots are somewhere, and what it observes."""
    task = build_environment(config).make(rows, build_options(config, is_evaluation=False))
    rng, ids = np.random.default_rng(8), np.arange(rows)
    task.reset(ids, ids.tolist())
    for _ in range(3):
        task.step(ids, rng.uniform(-1, 1, (rows, task.action_size)) * task.control_limit)
    return task, task.observe()


@pytest.mark.parametrize(
    "variant", [one for one in VARIANTS if not ENVIRONMENTS[one.name].task.sets_goals], ids="-".join
)
def test_a_controllers_egocentric_view_has_all_else_behind(variant):
    config = make_config(variant.name, "smoke", {"controller_view": "egocentric", "spec": variant.spec})
    design, (task, observed) = build_algorithm(config).design, moving(config, 3)
    robot, view = task.robot, design.controller_view
    coordinates = {each.name for each in (*robot.pose, *robot.velocity)}
    others = [i for i, name in enumerate(task.observation_names) if name not in coordinates]
    assert len(others) > 0
    own = tuple(f"egocentric {each.name}" for each in robot.egocentric)
    assert view.names(task.observation_names) == own + tuple(task.observation_names[i] for i in others)
    out, before = np.zeros((3, design.observation_sizes[0])), observed.copy()
    angle = view.write(observed, np.full(3, 99.0), out)  # not the heading
    assert np.array_equal(observed, before)
    qpos, qvel = np.split(observed[:, task.proprioception], [robot.num_qpos], axis=1)
    assert angle.tolist() == robot.frame_angle(qpos).tolist()
    assert out.tolist() == np.hstack([view_of(robot, qpos, qvel), observed[:, others]]).tolist()


def test_a_clock_runs_by_the_steps_of_its_environment():
    """Pendulum's are 1/30 of a second, a built-in task's a tenth."""
    for env, algorithm in (("gymnasium:Pendulum-v1", "es"), ("point-gather", "es"), ("point-gather", "shes")):
        config = make_config(env, "smoke", {"algorithm": algorithm, "clock_frequency": 1.0})
        task = build_environment(config).make(1, build_options(config, is_evaluation=False))
        assert build_algorithm(config).design.clock.step_s == task.step_s == (0.1 if "point" in env else 1 / 30)


SECTORS = {"controller_view": "sectors", "controller_output": "heading_direction"}


@pytest.mark.parametrize("env", ["ant-gather", "point-gather"])
@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_sectors_show_readings_and_the_component_of_each_vector(env, spec):
    config = make_config(env, "smoke", {"spec": spec, "reset_noise": 0.1, **SECTORS})
    design, (task, observed) = build_algorithm(config).design, moving(config, 8)
    goals = np.random.default_rng(1).normal(size=(8, 2))
    observed = np.concatenate([observed, goals], axis=1)
    view, before, out = design.controller_view, observed.copy(), np.full((8, 80), np.nan)
    assert view.size(task.observation_size) == design.observation_sizes[0] == 80
    assert view.write(observed, task.heading, out) is task.heading
    assert np.array_equal(observed, before)
    readings = observed[:, task.sensor_rings.ravel()]
    assert out[:, :20].tolist() == readings.tolist()
    assert out[:, 20:40] == pytest.approx(readings**8)
    for row in range(8):
        ahead = [np.cos(task.heading[row]), np.sin(task.heading[row])]
        vectors = np.array([ahead, task.position[row] / 8, task.sim.qvel[row, :2], goals[row]])
        for sector in range(10):
            middle = task.heading[row] - np.pi + (sector + 0.5) * np.pi / 5
            assert out[row, 40 + sector :: 10] == pytest.approx(vectors @ [np.cos(middle), np.sin(middle)], abs=1e-12)
    names = view.names(task.observation_names)
    picked = ("food_0", "poison_0, eighth power", "heading along sector 1", "goal along sector 9")
    assert tuple(names[i] for i in (0, 30, 41, 79)) == picked
    assert len(set(names)) == 80


BLOCK = ("block_x", "block_y", "block_vx", "block_vy")


@pytest.mark.parametrize(("env", "block"), [("ant-maze", ()), ("ant-push", BLOCK)])
def test_the_position_view_shows_the_place_and_the_task(env, block):
    made = build_algorithm(make_config(env, "smoke", {"controller_view": "position"}))
    seen = ("torso_x", "torso_y", *block, "time", "target_x", "target_y")
    assert made.design.controller_view.names(made.problem.sample().observation_names) == seen


@pytest.fixture
def strange():
    """An environment that Gymnasium makes, with a robot of which only its place is known."""
    register_external("own-maze", "shes/PointMaze-v0", locate=lambda observation, _: (*observation[:2], 0.0))
    yield
    del EXTERNAL_ENVIRONMENTS["own-maze"]


@pytest.mark.parametrize(
    ("env", "settings", "message"),
    [
        ("ant-maze", SECTORS, "'sectors', but ant-maze has the ant, and no sensors ... Set --controller-view to"),
        ("own-maze", {"primitive_view": "egocentric"}, "own-maze has an external robot ... Set --primitive-view to"),
        ("own-maze", {"controller_view": "egocentric"}, "own-maze has an external robot ... Set --controller-view to"),
        ("own-maze", {"controller_view": "position"}, "'position', but own-maze ... observes no absolute position"),
    ],
)
def test_a_view_that_an_environment_does_not_have_is_refused(env, settings, message, strange):
    with raises(ConfigError, message):
        build_algorithm(make_config(env, "smoke", settings))
    design = build_algorithm(make_config(env, "smoke")).design
    assert isinstance(design.controller_view, ColumnsView)
    assert isinstance(design.primitive_view, ColumnsView)
