"""External environments: episodes, actions and the robot's pose are those of the Gymnasium environment."""

import sys
from types import SimpleNamespace

import cloudpickle
import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.wrappers import TimeLimit
from numpy.testing import assert_allclose, assert_array_equal

import shes
from shes.drawing.make_drawer import make_drawer
from shes.envs.bodies.point import Point
from shes.envs.named_environments import INCLUDED, find_environment, register_environment, register_external
from shes.errors import ConfigError, MissingExtraError, ShapeError, UnknownNameError
from shes.runs.build import build_algorithm
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.viewing.playback import Playback
from tests.contracts import test_task_contract as contract
from tests.e2e import runs
from tests.e2e.own_classes import Corner
from tests.envs.episodes import assert_same_view, draw_actions, make_task, play, view
from tests.envs.external_envs import (
    MAX_STEPS,
    Body,
    Car,
    Holder,
    Silent,
    Stepper,
    locate_by_info,
    locate_car,
    registered,
)
from tests.messages import raises

ANT_MAZE = "robotics-ant-maze"
FREE = {"make": Body, "locate": None, "joints": "<freejoint/>"}
REFUSED = (ConfigError, UnknownNameError)


@pytest.fixture(autouse=True)
def registries():
    with registered():
        yield


def begin(name, num_episodes, seeds=None, **options):
    task = find_environment(name).with_options(options).make(num_episodes)
    task.reset(np.arange(num_episodes), range(num_episodes) if seeds is None else seeds)
    return task


def start(num_episodes, seeds=None, make=Car, locate=locate_car, score="return", made=None, **kwargs):
    """Return episodes of the class `make`, made with `kwargs`; append its environments to `made`."""

    def make_one(render_mode=None):
        env = make(render_mode=render_mode, **kwargs) if issubclass(make, Car) else make(**kwargs)
        if made is not None:
            made.append(env)
        return env

    register_external("tested", make_one, locate=locate, score=score)
    return begin("tested", num_episodes, seeds)


def test_our_own_point_maze_is_the_same_from_outside():
    inside, outside = make_task("point-maze", 3), begin("gymnasium:shes/PointMaze-v0", 3, [5, 10, 13])
    inside.reset(np.arange(3), [5, 10, 13])
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 3, 2)).astype(np.float32).astype(np.float64):
        inside.step(np.arange(3), action * inside.control_limit)
        outside.step(np.arange(3), action)
        for name in ("time", "reward", "running_return", "success", "diverged"):
            assert_array_equal(getattr(inside, name), getattr(outside, name), err_msg=name)
        assert_array_equal(inside.observe(), outside.observe())
    assert outside.physics_s > 0
    assert 0 < inside.success.sum() < 3


@pytest.mark.parametrize("locate", [locate_car, locate_by_info])
def test_dict_observations_are_flat_and_a_function_locates(locate):
    task, env = start(1, seeds=[3], locate=locate), Car()
    seen, _ = env.reset(seed=3)
    assert task.step_s == 1 / Car.metadata["render_fps"]
    assert_array_equal(task.primitive_view, [0, 1, 2, 3, 4, 5])  # all but the desired goal
    for control in draw_actions(task, 5):
        assert_array_equal(task.observe()[0, 3:], [*seen["pose"], *seen["desired_goal"]])  # the gear has three values
        assert task.observe()[0, :3].argmax() == seen["gear"]
        play(task, [control])
        seen, *_ = env.step(task.reader.to_action(control[None])[0])
        assert_array_equal(task.position[0], env.place)
        assert task.heading[0] == env.yaw


@pytest.mark.parametrize(
    ("env", "settings", "sizes"),
    [
        ("car", {"algorithm": "es"}, [8]),
        ("car", {}, [8, 3 + 6]),  # goal; gear and pose, not the desired goal
        ("car", {"primitive_view": "proprioception", "clock_frequency": 1.0}, [8, 3 + 2 + 6]),
        ("blind-car", {}, [8, 3 + 2]),
    ],
)
def test_levels_see_what_they_are_told_to(env, settings, sizes):
    register_external("car", Car, locate=locate_car)
    register_external("blind-car", Car, locate=locate_car, primitive_view=[0, 1])
    algorithm = build_algorithm(make_config(env, "smoke", settings))
    assert list(algorithm.design.observation_sizes) == sizes


SLIDES = "<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 1 0'/>"
LIFT = "<joint type='slide' axis='0 0 1'/>"
HINGE = "<joint type='hinge' axis='0 0 1'/>"


@pytest.mark.parametrize("make", [Body, Holder])
@pytest.mark.parametrize("joints", ["<freejoint/>", SLIDES, SLIDES + HINGE, LIFT + HINGE + SLIDES])
def test_the_joints_of_a_mujoco_body_say_where_it_is(make, joints):
    """The body's frame, which MuJoCo computes from qpos, must have the pose that the joints determine."""
    task = start(3, make=make, locate=None, joints=joints, made=(envs := []))
    for i, env in enumerate(envs):
        data = getattr(env, "inner", env).data
        mujoco.mj_forward(data.model, data)
        turn = data.xmat[1].reshape(3, 3)
        if HINGE + SLIDES not in joints:  # there the slides turn with it
            assert_allclose(task.position[i], data.xpos[1][:2], atol=1e-12)
        assert_allclose(task.heading[i], np.arctan2(turn[1, 0], turn[0, 0]), atol=1e-12)
        assert_array_equal(task.reader.locate(np.zeros((1, 1)), None, env)[0][0], task.position[i])
    assert len(np.unique(task.position)) == 6


@pytest.mark.parametrize(
    "joints",
    [
        "",
        "<joint type='slide' axis='1 0 0'/>" + LIFT + "<joint type='hinge' axis='0 1 0'/>",
        HINGE + "<geom size='.1'/><body><geom size='.1'/>" + SLIDES + "</body>",
    ],
)
def test_other_joints_do_not_say_where_a_robot_is(joints):
    task = start(2, make=Body, locate=None, joints=joints)
    assert not task.position.any()
    with pytest.raises(ConfigError):
        task.check_position()
    start(1).check_position()


@pytest.mark.parametrize(
    ("make", "controls", "actions"),
    [
        (Car, np.outer((-1, 1, 0, 5, -3), np.ones(3)), [(-2, 0, -1), (2, 4, 1), (0, 2, 0), (2, 4, 1), (-2, 0, -1)]),
        (Stepper, [[0.1, 0, 0, 0], [-1, -0.9, -1, -1], [0, 0.5, 0.6, 0.5], [0, 0, 0, 0.7]], [3, 4, 5, 6]),
    ],
)
def test_actions_are_stretched_to_the_bounds_or_chosen(make, controls, actions):
    assert_allclose(start(1, make=make).reader.to_action(np.array(controls)), actions)


@pytest.fixture(params=[{}, FREE], ids=["car", "body"])
def variant(request):
    """Return what the contract of tasks makes its tasks with."""
    start(1, **request.param)
    return SimpleNamespace(make_task=find_environment("tested").make)


# The parts of the contract that need no simulator of ours.
test_an_episode_depends_on_its_seed = contract.test_an_episode_depends_on_its_seed_and_not_on_the_past
test_actions_are_cut_at_the_limit = contract.test_actions_may_be_float32_and_are_cut_at_the_limit


def test_an_episode_does_not_depend_on_the_others():
    alone, crowd = start(1, seeds=[77]), start(5, seeds=[0, 1, 2, 2**100 + 77, 4])  # modulo 2**31
    assert len(np.unique(crowd.position, axis=0)) == 5
    resting = view(crowd, [0])
    for step, action in enumerate(draw_actions(alone, 9)):
        play(alone, [action])
        play(crowd, [action], ids=np.array([1, 3, 4]))
        assert_same_view(view(alone), view(crowd, [3]))
        assert_same_view(view(crowd, [0]), resting)
        crowd.reset(np.array([1, 2]), [np.int64(step), 0])
        assert_same_view(view(crowd, [2]), resting)


@pytest.mark.parametrize(
    ("ends", "is_fall"), [("terminates", True), ("truncates", False), ("terminates truncates", True)]
)
def test_an_end_without_success_is_a_fall_if_it_is_a_termination(ends, is_fall):
    ends = {f"{each}_after": 3 for each in ends.split()}
    task, actions = start(30, score="success", **ends), draw_actions(start(1), 3)
    play(task, actions[:2])
    assert not (task.fallen | task.terminated).any()
    play(task, actions[2:])
    assert task.terminated.all()
    assert (task.truncated != is_fall).all()
    near = np.abs(task.position - task.observe()[:, 6:]).max(axis=1) < 0.5
    assert 0 < near.sum() < 30
    assert_array_equal(task.success, near)
    assert_array_equal(task.score, near)
    assert_array_equal(task.fallen, ~near & is_fall)
    task.reset(np.arange(30), range(30))
    assert not (task.fallen | task.truncated).any()
    silent = start(2, make=Silent, **ends)  # reports no success
    play(silent, actions)
    assert (silent.fallen == is_fall).all()
    assert_array_equal(silent.score, silent.running_return)


@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e200])  # the square of the last is infinite
@pytest.mark.parametrize(("place", "score"), [("pose", "return"), ("pay", "success")])
def test_what_is_no_number_diverges_and_neither_pays_nor_scores(value, place, score):
    task, calm = start(2, spoils=place, value=value, score=score), start(2)
    actions = draw_actions(task, 3)
    assert_array_equal(play(task, actions[:2])["running_return"], play(calm, actions[:2])["running_return"])
    earned = task.running_return.copy()
    seen = play(task, actions[2:])
    assert seen["diverged"].all()
    for name in ("reward", "score", "success"):
        assert [str(each) for each in seen[name].astype(float)] == ["0.0", "0.0"], name
    assert_array_equal(task.running_return, earned)
    assert np.abs(task.observe()).max() < 10
    task.reset(np.arange(2), [0, 1])
    assert not task.diverged.any()


def test_a_mujoco_that_blows_up_diverges_until_its_reset():
    task = start(2, made=(envs := []), **FREE)
    envs[1].data.qvel[0] = 1e12
    for _ in range(2):
        assert_array_equal(play(task, np.zeros((1, 1)))["diverged"], [False, True])
    task.reset(np.array([1]), [1])
    assert not play(task, np.zeros((1, 1)))["diverged"].any()
    register_external("tested-2", lambda: envs.append(gymnasium.make("shes/PointMaze-v0")) or envs[-1])
    task = begin("tested-2", 2)
    envs[-1].unwrapped.task.sim.qvel[0, 0] = 1e12  # which that environment itself reports in its info
    assert_array_equal(play(task, np.zeros((1, 2)))["diverged"], [False, True])


@pytest.mark.parametrize("kind", ["terminates_after", "truncates_after"])
def test_an_end_without_a_report_of_the_score_is_refused(kind):
    play(start(2, make=Silent, score="success", spoils="pose", **{kind: 3}), np.zeros((3, 3)))  # diverges
    task = start(2, make=Silent, score="success", **{kind: 3})
    assert not play(task, np.zeros((2, 3)))["score"].any()
    with raises(ConfigError, "tested cannot step: its score is success, but ... not report it: empty"):
        play(task, np.zeros((1, 3)))


def test_the_horizon_is_the_limit_of_the_registration():
    def horizons(env, **settings):
        config = make_config(env, "laptop", {"algorithm": "es", **settings})
        return config.episodes.horizon, config.episodes.evaluation_horizon

    register_external("of-function", lambda: gymnasium.make("tests/Car-v0"))
    register_external("of-id", "tests/Car-v0")
    for name in ("gymnasium:tests/Car-v0", "of-id", "of-function"):
        assert horizons(name) == (MAX_STEPS, MAX_STEPS)
    assert horizons("of-id", horizon=30) == (30, MAX_STEPS)
    assert horizons("of-id", evaluation_horizon=30) == (MAX_STEPS, 30)
    assert horizons("of-id", env_kwargs={"max_episode_steps": 3}) == (3, 3)
    register_external("free", Car)
    assert horizons("free") == horizons("point-maze")


@pytest.mark.parametrize(
    ("make", "kwargs", "end"),
    [
        ("tests/Car-v0", {}, None),
        ("tests/Car-v0", {"max_episode_steps": 3, "terminates_after": 5}, 5),
        (lambda: TimeLimit(Car(), 5), {}, 5),
    ],
)
def test_the_limit_of_a_registration_does_not_end_an_episode(make, kwargs, end):
    register_external("limited", make)
    task = begin("limited", 1, env_kwargs=kwargs)
    ends = [play(task, [action])["terminated"][0] for action in draw_actions(task, 12)]
    assert (ends.index(True) + 1 if any(ends) else None) == end


# Options: keyword arguments and options of the reset, from a run's settings to each of its environments.


PLACED = {"env_kwargs": {"parts": [1, 2], "truncates_after": 9}, "reset_options": {"place": ["near", "far"]}}
TINY = {**runs.TINY, "horizon": 12, "evaluation_horizon": 15, "generations": 1, "population_size": 4}


def test_every_environment_of_a_run_has_its_recorded_options(tmp_path):
    given = []

    class Placed(Car):
        spec = SimpleNamespace(max_episode_steps=31)

        def reset(self, *, seed=None, options=None):
            given.append(("reset", options["place"].pop()))  # does not change what the next one gets
            return super().reset(seed=seed)

    def make(parts, render_mode=None, **kwargs):
        given.append(("made", parts.pop(), render_mode))
        return Placed(render_mode, **kwargs)

    register_external("placed", make, locate=locate_car)
    run = shes.train("placed", out=tmp_path / "run", **TINY, **PLACED)
    shes.evaluate(run.path, episodes=2, num_workers=1)
    playback = Playback(run.path, "last")
    playback.task.draw_by("rgb_array")
    next(playback.play(seed=3))
    assert set(given) == {("made", 2, None), ("made", 2, "rgb_array"), ("reset", "far")}
    assert RunFolder(run.path).read_record()["config"]["environment"].items() >= PLACED.items()
    assert make_config("placed", None, {"like": run.path}).values.items() >= PLACED.items()
    assert make_config("placed", "laptop", PLACED).episodes.horizon == 31
    # An episode that it truncates has ended, but not terminated.
    assert not run.progress["terminated_rate"].any()
    assert_array_equal(run.progress["episode_steps_mean"], 9)


NO_OBJECT = "env_kwargs must be a JSON object of names and values, e.g. --env-kwargs '{\"size\": 3}', got "
REFUSED_OPTIONS = [
    *(({"env_kwargs": each}, NO_OBJECT) for each in ("{size: 3}", "[3]", 3, "", '{"a b": 3}', {1: 2}, {"a": object()})),
    *(({"env_kwargs": each}, NO_OBJECT) for each in ('{"a": NaN}', "[" * 9999, {"a": {(1, 2): 3}})),
    ({"reset_options": "[]"}, "reset_options must be a JSON object ... '{\"start\": [0, 1]}', got '[]'. Set --res"),
    ({"env_kwargs": {"fuel": 1}}, "cannot be made with {'fuel': 1}: TypeError: ... unexpected keyword argument 'fuel'"),
    ({"device": "warp-cpu"}, "gymnasium:tests/Car-v0 has physics of its own: it runs ... Set --device cpu."),
    ({"env": "point-maze", "env_kwargs": "{}"}, "env_kwargs is not a setting of a run of point-maze ... Omit --env-kw"),
    (
        {"algorithm": "shes", **TINY},
        "of gymnasium:tests/Car-v0 is unknown ... register_external(name, ... --algorithm es",
    ),
]


@pytest.mark.parametrize(("settings", "message"), REFUSED_OPTIONS)
def test_settings_that_do_not_fit_are_refused(settings, message, tmp_path):
    with raises(ConfigError, message):
        shes.train(out=tmp_path / "run", **{"env": "gymnasium:tests/Car-v0", "algorithm": "es", **settings})
    assert list(tmp_path.iterdir()) == []


PLACE = " ... external_envs.py:"


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("reset", "cannot reset: RuntimeError: no fuel (" + PLACE),
        ("step", "cannot step: RuntimeError: no fuel (" + PLACE),
        ("exit", "cannot step: SystemExit: 3 (" + PLACE),
        ("shape", "cannot step: its observation must be one of Dict( ... ), got {'pose': array([0 ... , 'gear': ... "),
        ("scalar", "cannot step: its observation must be one of Dict( ... ), got np.float64(1.0)."),
        ("reward", "cannot step: its reward must be a number, got '1'."),
        *(
            (it, f"cannot step: its {it} must be ... '1'.")
            for it in ("terminated", "truncated", "is_success", "diverged")
        ),
        ("where", "cannot step: KeyError: 'where' (" + PLACE),
        ("success", "cannot step: its is_success must be True, False, 1 or 0, got array("),
    ],
)
def test_a_later_failure_is_one_line_with_the_name(fault, message):
    task = start(2, seeds=[0, 0], fault=fault, locate=locate_by_info)
    play(task, np.zeros((1, 3)))
    with raises(ConfigError, f"tested {message}") as caught:
        task.reset(np.array([1]), [3]) if fault == "reset" else play(task, np.zeros((1, 3)))
    assert "\n" not in str(caught.value)


def with_space(**spaces):
    return type("Odd", (Car,), spaces)


ACTION = "wrong cannot be used: its action space must be Discrete or a Box of floats within 1e+100, not empty; got "
OBSERVATION = "wrong cannot be used: its observation space must have a fixed size of at least 1, got "
LARGEST = np.finfo(np.float64).max


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (with_space(action_space=Box(-np.inf, np.inf, (3,))), {}, ACTION + "Box(-inf"),
        (with_space(action_space=Box(-LARGEST, LARGEST, (3,), np.float64)), {}, ACTION + "Box(-1.79"),
        (with_space(action_space=Box(-1, 1, (0,))), {}, ACTION + "Box([]"),
        (with_space(action_space=Box(-1, 1, (2,), np.int64)), {}, ACTION + "Box(-1"),
        (with_space(observation_space=gymnasium.spaces.Sequence(Box(-1, 1, (2,)))), {}, OBSERVATION + "Sequence"),
        (with_space(observation_space=Box(-1, 1, (0,))), {}, OBSERVATION + "Box([]"),
        (with_space(metadata={"render_fps": "fast"}), {}, "wrong cannot be used: ValueError: ... 'fast'"),
        ("tests/Cra-v0", {}, "unknown Gymnasium environment 'tests/Cra-v0'. Did you mean 'tests/Car-v0' ... --import"),
        ("zzzzzz", {}, "'zzzzzz'. Known: none like it. Import its package"),
        ("os:Car-v0", {}, "unknown Gymnasium environment 'os:Car-v0'"),
        (lambda: Car(fuel=1), {}, "wrong cannot be made: TypeError: ... fuel"),
        (lambda: 3, {}, "its function must return a gymnasium.Env, got 3"),
        (3, {}, "make must be a Gymnasium id or a function that returns an environment, got 3"),
        (Car, {"locate": "pose"}, "locate must be a function of an observation and its info, got 'pose'"),
        (Car, {"locate": lambda *_: (0, 0)}, "locate must return (x, y, heading), got (0, 0)"),
        (Car, {"primitive_view": [0, 8]}, "primitive_view must be distinct indices from 0 to 7, got (0, 8)"),
        (Car, {"primitive_view": [1, 1]}, "primitive_view must be distinct indices from 0 to 7, got (1, 1)"),
        (Car, {"primitive_view": "pose"}, "primitive_view must be indices in the flat observation, got 'pose'"),
        (Car, {"score": "best"}, "unknown score 'best'. Known: return, success"),
    ],
)
def test_what_does_not_fit_is_refused(make, settings, message):
    def use():
        register_external("wrong", make, **settings)
        begin("wrong", 1, [1])

    with raises(REFUSED, message):
        use()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Silent, "drawn has no render mode 'rgb_array', only none"),
        (lambda render_mode=None: Car(render_mode, fault="draw"), "drawn cannot be drawn: RuntimeError: no lamp"),
        (lambda: Car(), "drawn cannot be made with {'render_mode': 'rgb_array'}: TypeError"),  # noqa: PLW0108
    ],
)
def test_without_pictures_there_is_a_clear_error(make, message):
    register_external("drawn", make)
    task = find_environment("drawn").make(1)

    def draw():
        make_drawer(task, 64, 64)
        task.reset(np.array([0]), [1])
        task.pose(0)

    with raises(ConfigError, message):
        draw()


@pytest.mark.parametrize(
    ("name", "missing", "extra"),
    [
        (ANT_MAZE, "gymnasium_robotics", "shes[robotics]"),
        ("gymnasium:PointMaze_Open-v3", "gymnasium_robotics", "shes[robotics]"),
        ("gymnasium:HalfCheetah-v5", "imageio", "gymnasium[mujoco]"),
        ("gymnasium:LunarLander-v3", "Box2D", "gymnasium[box2d]"),
    ],
)
def test_a_missing_package_names_the_extra_that_brings_it(name, missing, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, missing, None)
    for each in [each for each in sys.modules if each.startswith(("gymnasium.envs.mujoco", "gymnasium.envs.box2d"))]:
        monkeypatch.delitem(sys.modules, each)
    environment = find_environment(name)
    monkeypatch.delitem(gymnasium.registry, "AntMaze_UMaze-v5", raising=False)
    monkeypatch.delitem(gymnasium.registry, "PointMaze_Open-v3", raising=False)
    with raises(MissingExtraError, f"{name} cannot be ... : ... {missing} ... (pip install '{extra}')"):
        environment.make(1)


def test_observations_may_be_of_one_environment_or_several():
    reader, env = start(1).reader, Car()
    observation, info = env.reset(seed=1)
    flat = gymnasium.spaces.flatten(env.observation_space, observation)
    rows, is_single = reader.rows(observation, 1)
    assert is_single
    assert_array_equal(rows, flat[None])
    observations, infos = gymnasium.make_vec("tests/Car-v0", 3, vectorization_mode="sync").reset(seed=1)
    rows, is_single = reader.rows(observations, 3)
    assert not is_single
    assert_array_equal(rows[0], flat)
    by_info = start(1, locate=locate_by_info).reader
    for mine, theirs in zip(by_info.locate(rows, infos), reader.locate(rows, None), strict=True):
        assert_array_equal(mine, theirs)
    assert_array_equal(by_info.locate(rows[:1], info)[0], rows[:1, 3:5])
    with raises(ConfigError, "locate failed (KeyError('where')) ... agent.act(observation, info)"):
        by_info.locate(rows, None)
    with raises(ConfigError, "agent.act(observation, env=env)"):
        start(1, **FREE).reader.locate(np.zeros((1, 1)), None)
    for wrong in (np.zeros(11), np.zeros((2, 8)), {"pose": np.zeros(3)}, None, "car"):
        with raises(ShapeError, "not an observation of 1 times Dict"):
            reader.rows(wrong, 1)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tests/Car-v0", "'tests/Car-v0' is a Gymnasium id. Write gymnasium:tests/Car-v0."),
        ("cartpole", "'cartpole' is a Gymnasium id. Write gymnasium:CartPole-v1."),
        ("shes/PointGather-v0", "'shes/PointGather-v0' is a Gymnasium id. Write point-gather."),
        ("shes/AntMazeHiro-v0", "is a Gymnasium id. Write ant-maze --spec hiro."),
        ("ant-gathr", "unknown environment 'ant-gathr'. Did you mean 'ant-gather' ... gymnasium:ID"),
    ],
)
def test_a_name_that_there_is_not_is_told_the_right_one(name, message):
    with raises(REFUSED, message):
        make_config(name)


def test_a_name_may_be_registered_again_by_its_function_alone():
    register_external("point-corner", "tests/Car-v0")
    for name, make in (("ant-gather", Car), (ANT_MAZE, INCLUDED[ANT_MAZE].source), ("point-corner", Car)):
        with raises(ConfigError, f"environment '{name}' is ... already ... Choose another name"):
            register_external(name, make)
    register_external("of-class", Car)
    again = type("Car", (Car,), {"__module__": Car.__module__, "__qualname__": Car.__qualname__})
    register_external("of-class", again)
    assert find_environment("of-class").source is again
    with pytest.raises(ConfigError):
        register_external("My Car", Car)
    register_external("point-corner", "gymnasium:tests/Car-v0")
    assert find_environment("point-corner").source == "tests/Car-v0"
    with raises(ConfigError, "'point-corner' is already an external environment. Choose another"):
        register_environment("point-corner", Point, Corner)


def test_a_worker_needs_no_registration():
    sent = cloudpickle.dumps(find_environment("gymnasium:tests/Car-v0"))
    del gymnasium.registry["tests/Car-v0"]
    assert cloudpickle.loads(sent).make(1).observation_size == 8
