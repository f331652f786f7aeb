"""Views: what levels see, against rotation matrices written out and the names that environments give."""

import mujoco
import numpy as np
import pytest

from shes.algorithms.evolution.designs import primitive_inputs
from shes.envs.bodies.ant import Ant
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS, register_external
from shes.envs.worlds import empty_world
from shes.errors import ConfigError
from shes.hierarchy.views import ColumnsView, EgocentricView
from shes.runs.build import build_algorithm, build_task
from shes.training.make_config import make_config
from tests.contracts.variants import VARIANTS

BODIES = {body.name: body for body in (environment.body for environment in ENVIRONMENTS.values())}
ROWS = 6


def _rotation(quaternion):
    """Return the matrix [3, 3] of a unit quaternion w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _about_vertical(angle):
    return _rotation([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])


def _twist(rotation):
    """Return the angle about the vertical after which what is left of `rotation` is a tilt about a level axis."""
    angle = np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    tilt = _about_vertical(angle).T @ rotation
    assert tilt[1, 0] == pytest.approx(tilt[0, 1], abs=1e-12)  # no axis of rotation stands up
    return angle


def _random_ants(seed=0, rows=ROWS):
    """Return poses [N, 15] and velocities [N, 14] of ants that lie in any way."""
    rng = np.random.default_rng(seed)
    qpos, qvel = rng.normal(0, 2, (rows, 15)), rng.normal(0, 3, (rows, 14))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos, qvel


def _view(body, qpos, qvel):
    out = np.full((len(qpos), len(body.egocentric)), np.nan)
    body.write_egocentric(qpos, qvel, body.frame_angle(qpos), out)
    return out


def test_every_value_of_the_ants_egocentric_view_is_the_one_that_its_name_says():
    spec = empty_world("ant", "euler")
    Ant().add_to(spec)
    model = spec.compile()
    qpos, qvel = _random_ants()
    seen = _view(Ant(), qpos, qvel)
    assert np.isfinite(seen).all()
    for row in range(ROWS):
        rotation = _rotation(qpos[row, 3:7])
        ahead = _about_vertical(_twist(rotation)).T  # from the world's axes to those of the frame
        tilt, velocity = ahead @ rotation @ [0, 0, 1], ahead @ qvel[row, :3]
        expected = {
            "torso_z": qpos[row, 2],
            "tilt_ahead": tilt[0],
            "tilt_left": tilt[1],
            "velocity_ahead": velocity[0],
            "velocity_left": velocity[1],
            "velocity_up": velocity[2],
            **{f"torso_w{axis}": qvel[row, 3 + i] for i, axis in enumerate("xyz")},
        }
        for joint in range(1, model.njnt):
            name = model.joint(joint).name
            expected[name] = qpos[row, model.jnt_qposadr[joint]]
            expected[f"{name}_velocity"] = qvel[row, model.jnt_dofadr[joint]]
        assert len(expected) == model.nq + model.nv - 4  # without x, y, yaw, and one of a quaternion's four
        assert dict(zip((each.name for each in Ant.egocentric), seen[row], strict=True)) == pytest.approx(
            expected, abs=1e-12
        )


def test_mujocos_angular_velocity_is_the_torsos_own():
    """So that it is egocentric as it is: a spin about the world's x axis, seen by a torso that looks along y."""
    spec = empty_world("ant", "euler")
    Ant().add_to(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    half = np.pi / 4
    data.qpos[3:7] = [np.cos(half), 0, 0, np.sin(half)]
    data.qvel[3:6] = [0, -1, 0]
    mujoco.mj_forward(model, data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, model.body("torso").id, velocity, 0)
    assert velocity[:3] == pytest.approx([1, 0, 0], abs=1e-12)


def test_the_ants_view_does_not_change_when_the_world_is_moved_and_turned():
    qpos, qvel = _random_ants(1)
    before = _view(Ant(), qpos, qvel)
    for angle in (0.3, 2.0, np.pi, -2.9):
        world = _about_vertical(angle)
        turned, velocity = qpos.copy(), qvel.copy()
        turned[:, :3] = qpos[:, :3] @ world.T + [3.0, -7.0, 0.0]
        velocity[:, :3] = qvel[:, :3] @ world.T
        for row in range(ROWS):
            mujoco.mju_mulQuat(turned[row, 3:7], [np.cos(angle / 2), 0, 0, np.sin(angle / 2)], qpos[row, 3:7])
        assert _view(Ant(), turned, velocity) == pytest.approx(before, abs=1e-12)
        turned[:, 3:7] *= -1  # the other quaternion of the same pose
        assert _view(Ant(), turned, velocity) == pytest.approx(before, abs=1e-12)


def test_an_upright_ants_frame_is_its_heading():
    qpos, _ = _random_ants(2)
    angles = np.linspace(-3, 3, ROWS)
    qpos[:, 3:7] = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], axis=1)
    assert Ant().frame_angle(qpos) == pytest.approx(angles)
    assert Ant().heading(qpos) == pytest.approx(angles)


def test_a_point_sees_its_velocity_and_a_falling_one_its_height_too():
    rng = np.random.default_rng(3)
    qpos, qvel = rng.normal(size=(2, 4, 2))
    assert _view(Point(), qpos, qvel).tolist() == qvel.tolist()
    qpos, qvel = rng.normal(size=(2, 4, 3))
    assert _view(FallingPoint(), qpos, qvel).tolist() == np.hstack([qpos[:, 2:], qvel]).tolist()
    assert [each.name for each in Point.egocentric] == ["torso_vx", "torso_vy"]
    assert [each.name for each in FallingPoint.egocentric] == ["torso_z", "torso_vx", "torso_vy", "torso_vz"]
    assert not Point().frame_angle(qpos).any()


@pytest.mark.parametrize("body", [body() for body in BODIES.values()], ids=BODIES)
def test_no_egocentric_view_shows_where_the_robot_is(body):
    rng = np.random.default_rng(4)
    qpos, qvel = rng.normal(size=(3, body.num_qpos)), rng.normal(size=(3, body.num_qvel))
    before = _view(body, qpos, qvel)
    qpos[:, :2] += [10, -20]
    assert _view(body, qpos, qvel).tolist() == before.tolist()
    names = [each.name for each in body.egocentric]
    assert len(set(names)) == len(names)
    assert not {"torso_x", "torso_y"} & set(names)


# Views of observations ----------------------------------------------------------------------------------------------

NAMES = ("a", "b", "c", "d", "e")


@pytest.mark.parametrize(
    ("view", "picked"),
    [
        (ColumnsView(), [0, 1, 2, 3, 4]),
        (ColumnsView((1, 2, 3)), [1, 2, 3]),
        (ColumnsView([3, 0, 4]), [3, 0, 4]),
        (ColumnsView((2,)), [2]),
    ],
    ids=["all", "neighbours", "any order", "one"],
)
def test_columns_are_copied_in_the_order_asked_for(view, picked):
    observation, out = np.random.default_rng(5).normal(size=(3, 5)), np.zeros((3, len(picked)))
    heading = np.array([0.1, 0.2, 0.3])
    assert view.size(5) == len(picked)
    assert view.names(NAMES) == tuple(NAMES[i] for i in picked)
    assert not view.is_egocentric
    assert view.write(observation, heading, out) is heading
    assert out.tolist() == observation[:, picked].tolist()


@pytest.mark.parametrize("others", [(), (0, 1), (2, 0)], ids=["alone", "neighbours", "any order"])
@pytest.mark.parametrize("first", [3, 0])
@pytest.mark.parametrize("shuffled", [False, True])
def test_an_egocentric_view_is_the_robots_then_the_others(others, first, shuffled):
    """Wherever the robot's coordinates stand in the observation."""
    qpos, qvel = _random_ants(6)
    rng = np.random.default_rng(7)
    places = rng.permutation(29) if shuffled else np.arange(29)
    others = tuple(29 + i if first == 0 else i for i in others)
    observation = rng.normal(size=(ROWS, 32))
    observation[:, first + places] = np.hstack([qpos, qvel])
    view = EgocentricView(Ant(), (first + places).tolist(), others)
    names = [f"value {i}" for i in range(32)]
    assert view.is_egocentric
    assert view.size(32) == 25 + len(others)
    assert view.names(names) == (
        *(f"egocentric {each.name}" for each in Ant.egocentric),
        *(f"value {i}" for i in others),
    )
    before, out = observation.copy(), np.zeros((ROWS, view.size(32)))
    angle = view.write(observation, np.full(ROWS, 99.0), out)  # not the heading
    assert angle.tolist() == Ant().frame_angle(qpos).tolist()
    assert out[:, :25].tolist() == _view(Ant(), qpos, qvel).tolist()
    assert out[:, 25:].tolist() == observation[:, list(others)].tolist()
    assert np.array_equal(observation, before)


def _states(task, rows):
    """Step `task` a little, so that robots are somewhere; return what it observes."""
    rng = np.random.default_rng(8)
    task.reset(np.arange(rows), list(range(rows)))
    for _ in range(3):
        task.step(np.arange(rows), rng.uniform(-1, 1, (rows, task.action_size)) * task.control_limit)
    return task.observe()


@pytest.mark.parametrize("variant", [each for each in VARIANTS if not ENVIRONMENTS[each.name].sets_goals], ids="-".join)
def test_a_controllers_egocentric_view_is_the_robots_then_all_else_in_order(variant):
    config = make_config(variant.name, "smoke", {"controller_view": "egocentric", "spec": variant.spec})
    design, task = build_algorithm(config).design, build_task(config, 3, is_evaluation=False)
    own = [each.name for each in task.robot.egocentric]
    coordinates = {each.name for each in (*task.robot.pose, *task.robot.velocity)}
    others = [i for i, name in enumerate(task.observation_names) if name not in coordinates]
    assert others
    assert not {"torso_x", "torso_y"} & {task.observation_names[i] for i in others}
    view = design.controller_view
    assert view.names(task.observation_names) == (
        *(f"egocentric {name}" for name in own),
        *(task.observation_names[i] for i in others),
    )
    assert design.controller.sizes[0] == view.size(task.observation_size) == len(own) + len(others)
    observed = _states(task, 3)
    out = np.zeros((3, len(own) + len(others)))
    view.write(observed, task.heading, out)
    sees = observed[:, task.proprioception]
    robot = task.robot
    assert out[:, : len(own)].tolist() == _view(robot, sees[:, : robot.num_qpos], sees[:, robot.num_qpos :]).tolist()
    assert out[:, len(own) :].tolist() == observed[:, others].tolist()
    plain = build_algorithm(config.having(controller_view="observation")).design
    assert plain.controller.sizes[0] == task.observation_size


@pytest.mark.parametrize("env", ["ant-gather", "ant-flagrun", "point-maze", "point-fall", "point-flagrun"])
def test_a_primitives_egocentric_view_is_the_robots_alone(env):
    config = make_config(env, "smoke", {"primitive_view": "egocentric", "clock_frequency": 1.0})
    body = ENVIRONMENTS[env].body
    learner = build_algorithm(config)
    names = [f"egocentric {each.name}" for each in body.egocentric]
    inputs = primitive_inputs(learner.problem)
    assert inputs[5:] == tuple(names)
    assert learner.design.primitive.sizes[0] == len(inputs) == 3 + 2 + len(names)


SECTORS = {"controller_view": "sectors", "controller_output": "heading_direction"}


@pytest.mark.parametrize("env", ["ant-gather", "point-gather"])
@pytest.mark.parametrize("spec", ["shes", "hiro"])
def test_the_view_by_sectors_has_the_readings_and_the_component_of_each_vector_along_each_sector(env, spec):
    config = make_config(env, "smoke", {"spec": spec, "reset_noise": 0.1, **SECTORS})
    design, task = build_algorithm(config).design, build_task(config, 8, is_evaluation=False)
    observed, view = _states(task, 8), design.controller_view
    before, out = observed.copy(), np.full((8, 70), np.nan)
    assert view.size(task.observation_size) == design.controller.sizes[0] == 70
    assert view.write(observed, task.heading, out) is task.heading
    assert np.array_equal(observed, before)
    readings = observed[:, task.sensor_rings.ravel()]
    assert out[:, :20].tolist() == readings.tolist()
    assert out[:, 20:40] == pytest.approx(readings**8)
    for row in range(8):
        ahead = [np.cos(task.heading[row]), np.sin(task.heading[row])]
        vectors = (ahead, task.position[row] / 8, task.sim.qvel[row, :2])
        for sector in range(10):
            middle = task.heading[row] - np.pi + (sector + 0.5) * np.pi / 5
            along = [vector[0] * np.cos(middle) + vector[1] * np.sin(middle) for vector in vectors]
            assert out[row, 40 + sector :: 10].tolist() == pytest.approx(along, abs=1e-12)
    names = view.names(task.observation_names)
    assert len(set(names)) == 70
    assert (names[0], names[30], names[41], names[69]) == (
        "food_0", "poison_0, eighth power", "heading along sector 1", "velocity along sector 9",
    )  # fmt: skip


def test_a_task_without_sensors_around_the_robot_has_no_view_by_sectors():
    message = (
        r"'sectors', but ant-maze has the ant, and no sensors around it.*, as Gather has\. Set --controller-view to"
    )
    with pytest.raises(ConfigError, match=message):
        build_algorithm(make_config("ant-maze", "smoke", SECTORS))


POSITION = ("torso_x", "torso_y")
BLOCK = ("block_x", "block_y", "block_vx", "block_vy")


@pytest.mark.parametrize(
    ("env", "settings", "seen"),
    [
        ("ant-maze", {}, (*POSITION, "time", "target_x", "target_y")),
        ("ant-push", {"observe_block": True}, (*POSITION, *BLOCK, "time", "target_x", "target_y")),
    ],
)
def test_the_position_view_shows_where_the_robot_is_and_what_is_not_the_robot(env, settings, seen):
    made = build_algorithm(make_config(env, "smoke", {**settings, "controller_view": "position"}))
    assert made.design.controller_view.names(made.problem.sample().observation_names) == seen


STRANGE = "own-maze"


@pytest.fixture
def strange():
    """An environment that Gymnasium makes, with a robot of which only its place is known."""
    register_external(STRANGE, "shes/PointMaze-v0", locate=lambda observation, _: (*observation[:2], 0.0))
    yield
    del EXTERNAL_ENVIRONMENTS[STRANGE]


@pytest.mark.parametrize("setting", ["primitive_view", "controller_view"])
def test_a_robot_that_gymnasium_made_has_no_egocentric_view(setting, strange):
    flag = "--" + setting.replace("_", "-")
    with pytest.raises(
        ConfigError, match=rf"{setting} is 'egocentric', but {STRANGE} has an external robot.*Set {flag} to"
    ):
        build_algorithm(make_config(STRANGE, "smoke", {setting: "egocentric"}))
    design = build_algorithm(make_config(STRANGE, "smoke")).design
    assert isinstance(design.controller_view, ColumnsView)
    assert isinstance(design.primitive_view, ColumnsView)


def test_the_symmetry_of_a_robot_that_gymnasium_made_is_not_asked_for(strange):
    """An egocentric view, without which there is none, is refused before."""
    settings = {"primitive_view": "egocentric", "symmetry": "rotation"}
    with pytest.raises(ConfigError, match=f"{STRANGE} has an external robot"):
        build_algorithm(make_config(STRANGE, "smoke", settings))


def test_a_robot_whose_place_is_not_observed_has_no_position_view(strange):
    message = (
        rf"controller_view is 'position', but {STRANGE} has an external robot, which observes no absolute position"
    )
    with pytest.raises(ConfigError, match=message):
        build_algorithm(make_config(STRANGE, "smoke", {"controller_view": "position"}))
