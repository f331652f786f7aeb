"""External environments: what a description says is where it is, and an episode is the environment's own."""

import sys

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.drawing.rendering import make_drawer, open_window
from shes.envs.bodies.point import Point
from shes.envs.external.description import ExternalDescription, read_description
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS, READY
from shes.envs.registry import find_description, make_task, register_environment, register_external_environment
from shes.envs.tasks.options import TaskOptions
from shes.errors import ConfigError, MissingExtraError, ShapeError, UnknownNameError
from tests.e2e.own_classes import Corner
from tests.envs.external_envs import CAR, POINT_MAZE, STEP_M, register

SHOWN = ("time", "reward", "running_return", "score", "success", "terminated", "diverged", "position", "heading")


@pytest.fixture(autouse=True)
def registries(monkeypatch):
    """The registries with the environments of the tests in them; what a test adds is forgotten afterwards."""
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    register()
    before = dict(EXTERNAL_ENVIRONMENTS)
    yield
    EXTERNAL_ENVIRONMENTS.clear()
    EXTERNAL_ENVIRONMENTS.update(before)


def find(**changes):
    return ExternalEnvironment.find(ExternalDescription(**{**CAR, **changes}))


def start(num_episodes, seeds=None, **changes):
    task = find(**changes).make(num_episodes)
    task.reset(np.arange(num_episodes), range(num_episodes) if seeds is None else seeds)
    return task


def view(task, rows=slice(None)):
    seen = {name: np.array(getattr(task, name)[rows]) for name in SHOWN}
    return {**seen, "observation": task.observe()[rows].copy()}


def assert_same_view(left, right):
    for name, values in left.items():
        assert_array_equal(values, right[name], err_msg=name)


def draw_actions(task, steps, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, task.action_size))


def play(task, actions, ids=None):
    for action in actions:
        task.step(np.arange(task.num_episodes) if ids is None else ids, np.tile(action, (task.num_episodes, 1)))
    return view(task)


# The same as a task of our own.


def test_our_own_point_maze_is_the_same_from_outside():
    inside, outside = make_task("point-maze", 3), start(3, **{**CAR, "heading": (), "primitive_view": (), **POINT_MAZE})
    seeds = [5, 6, 7]
    for task in (inside, outside):
        task.reset(np.arange(3), seeds)
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 3, 2)).astype(np.float32).astype(np.float64):
        inside.step(np.arange(3), action * inside.control_limit)
        outside.step(np.arange(3), action)
        for name in ("time", "reward", "running_return", "score", "success", "diverged", "position", "heading"):
            assert_array_equal(getattr(inside, name), getattr(outside, name), err_msg=name)
        assert_array_equal(inside.observe(), outside.observe())
    assert_array_equal(inside.proprioception, outside.proprioception)
    assert_array_equal(inside.primitive_view, outside.primitive_view)


# What is where.


def test_dict_observations_are_flat_in_the_order_of_their_space():
    task = start(1, seeds=[3])
    env = gymnasium.make("tests/Car-v0")
    observation, _ = env.reset(seed=3)
    assert_array_equal(task.observe()[0], gymnasium.spaces.flatten(env.observation_space, observation))
    assert list(env.observation_space.spaces) == ["gear", "pose", "target", "turn"]
    assert_array_equal(task.proprioception, [3, 4, 5])
    assert_array_equal(task.primitive_view, [0, 1, 2, 3, 4, 5])
    assert_array_equal(task.position[0], observation["pose"][:2])
    assert task.heading[0] == pytest.approx(observation["pose"][2])


@pytest.mark.parametrize(
    "position", [[3, 4], "3:5", "pose[0:2]", ["pose[0]", "pose[1]"], ["x", "y"], "where", (3, "y")]
)
def test_a_position_may_be_said_in_many_ways(position):
    task, plain = start(2, position=position), start(2)
    actions = draw_actions(task, 5)
    assert_same_view(play(task, actions), play(plain, actions))


@pytest.mark.parametrize("heading", [5, "pose[2]", "turn", "8:12"])
def test_a_heading_is_an_angle_or_a_quaternion(heading):
    task, plain = start(3, heading=heading), start(3)
    play(task, np.ones((20, 3)))
    play(plain, np.ones((20, 3)))
    np.testing.assert_allclose(task.heading, plain.heading, atol=1e-6)
    assert (np.abs(task.heading) <= np.pi).all()
    assert np.abs(task.observe()[:, 5]).max() > np.pi  # the environment's own angle goes on


def test_without_a_word_of_it_heading_is_zero_and_the_primitive_sees_everything():
    task = start(2, heading=(), proprioception=(), primitive_view=())
    assert not task.heading.any()
    assert_array_equal(task.primitive_view, np.arange(12))
    assert_array_equal(task.proprioception, np.arange(12))
    assert_array_equal(start(1, proprioception=()).proprioception, np.arange(6))


def test_actions_are_stretched_to_the_bounds_and_cut_at_them():
    low, high = np.array([-2, 0, -1]), np.array([2, 4, 1])
    for control, expected in ((-1, low), (1, high), (0, (low + high) / 2), (5, high), (-3, low)):
        task = start(1)
        before = task.position.copy()
        task.step(np.array([0]), np.full((1, 3), control))
        np.testing.assert_allclose(task.position - before, [STEP_M * expected[:2]], atol=1e-6)
    assert task.control_limit == 1


# Episodes.


def test_the_same_seed_gives_the_same_episode_whatever_the_batch_and_the_past():
    alone, crowd = start(1, seeds=[77]), start(5)
    play(crowd, draw_actions(crowd, 9, seed=3))
    crowd.reset(np.array([3]), [77])
    for action in draw_actions(alone, 15):
        play(alone, [action])
        play(crowd, [action])
        mine, theirs = view(alone), view(crowd, [3])
        assert_same_view(mine, theirs)
    assert len(np.unique(start(20).observe(), axis=0)) == 20


def test_a_seed_may_be_any_non_negative_integer():
    task = start(3, seeds=[0, np.int64(2**62 + 1), 2**100 + 2])
    assert_array_equal(task.observe(), start(3).observe())


def test_only_the_episodes_that_are_stepped_or_reset_move():
    task = start(4)
    before = view(task)
    play(task, draw_actions(task, 3), ids=np.array([1, 2]))
    after = view(task)
    for name, values in before.items():
        assert_array_equal(after[name][[0, 3]], values[[0, 3]], err_msg=name)
    assert_array_equal(task.time, [0, 3, 3, 0])
    task.reset(np.array([1]), [1])
    assert_same_view(view(task, [1]), {name: values[[1]] for name, values in before.items()})
    assert_array_equal(task.time, [0, 0, 3, 0])


def test_the_callers_actions_are_not_changed():
    task = start(2)
    actions = draw_actions(task, 2) * 3
    before = actions.copy()
    task.step(np.arange(2), actions)
    assert_array_equal(actions, before)


def test_the_time_limit_of_the_registration_does_not_count():
    task = start(1)
    assert gymnasium.spec("tests/Car-v0").max_episode_steps == 7
    seen = play(task, draw_actions(task, 30))
    assert not seen["terminated"].any()
    assert seen["time"] == 30


@pytest.mark.parametrize("kind", ["terminates_after", "truncates_after"])
def test_an_episode_ends_by_the_environments_own_rule(kind):
    task = start(2, kwargs={kind: 3})
    actions = draw_actions(task, 3)
    assert not play(task, actions[:2])["terminated"].any()
    assert play(task, actions[2:])["terminated"].all()
    assert not task.diverged.any()


@pytest.mark.parametrize("kind", ["nan_after", "bad_reward_after"])
@pytest.mark.parametrize("score", ["return", "success"])
def test_what_is_not_finite_diverges_and_neither_pays_nor_scores(kind, score):
    task, calm = start(2, kwargs={kind: 3}, score=score), start(2)
    actions = draw_actions(task, 3)
    assert_array_equal(play(task, actions[:2])["running_return"], play(calm, actions[:2])["running_return"])
    earned = task.running_return.copy()
    seen = play(task, actions[2:])
    assert seen["diverged"].all()
    for name in ("reward", "score", "success"):
        assert not seen[name].any(), name
    assert_array_equal(task.running_return, earned)
    assert np.isfinite(task.observe()).all()
    task.reset(np.arange(2), [0, 1])
    assert not task.diverged.any()


def test_what_an_environment_says_itself_of_its_divergence_counts():
    task = start(2, **{**CAR, "heading": (), "primitive_view": (), **POINT_MAZE})
    task._envs[1].unwrapped._adapter.task.sim.qvel[0, 0] = 1e12
    play(task, np.zeros((1, 2)))
    assert_array_equal(task.diverged, [False, True])


def test_success_and_score():
    by_return, by_success = start(30), start(30, score="success")
    for task in (by_return, by_success):
        play(task, draw_actions(task, 3))
    near = np.abs(by_return.position - by_return.observe()[:, 6:8]).max(axis=1) < 0.5
    assert 0 < near.sum() < 30
    assert_array_equal(by_return.success, near)
    assert_array_equal(by_return.score, by_return.running_return)
    assert_array_equal(by_success.score, near)


def test_success_may_be_reported_at_the_end_of_an_episode_alone():
    task, calm = start(30, id="tests/Late-v0", score="success", kwargs={"terminates_after": 3}), start(30)
    actions = draw_actions(task, 3)
    assert not play(task, actions[:2])["success"].any()
    play(task, actions[2:])
    play(calm, actions)
    right_of_it = calm.observe()[:, 3] > calm.observe()[:, 6]
    assert 0 < right_of_it.sum() < 30
    assert_array_equal(task.score, right_of_it)


def test_who_is_cut_off_before_a_word_of_success_has_not_succeeded():
    task = start(3, id="tests/Late-v0", score="success", kwargs={"terminates_after": 9})
    seen = play(task, draw_actions(task, 8))
    assert not seen["terminated"].any()
    assert not seen["score"].any()


@pytest.mark.parametrize("kind", ["terminates_after", "truncates_after"])
def test_an_episode_that_ends_without_a_word_of_success_is_refused_if_it_is_the_score(kind):
    changes = {"id": "tests/Mute-v0" if kind == "terminates_after" else "tests/Silent-v0", "kwargs": {kind: 3}}
    play(start(2, **changes), np.zeros((3, 3)))
    task = start(2, **changes, score="success")
    play(task, np.zeros((2, 3)))
    shown = "'won'" if kind == "terminates_after" else "nothing"
    message = (
        rf"^{changes['id']}: its score cannot be \"success\": info at the end of an episode has neither 'success' nor "
        rf"'is_success', only {shown}\. Take score = \"return\"\.$"
    )
    with pytest.raises(ConfigError, match=message):
        play(task, np.zeros((1, 3)))
    with pytest.raises(ConfigError, match=message):
        find(**{**changes, "kwargs": {kind: 1}}, score="success")


def test_an_episode_that_diverges_need_not_say_how_it_ended():
    task = start(2, id="tests/Silent-v0", score="success", kwargs={"truncates_after": 3, "nan_after": 3})
    seen = play(task, np.zeros((3, 3)))
    assert seen["terminated"].all()
    assert seen["diverged"].all()


@pytest.mark.parametrize("score", ["return", "success"])
def test_the_score_of_a_divergence_is_a_plain_zero(score):
    task = start(2, kwargs={"nan_after": 3}, score=score)
    play(task, np.zeros((3, 3)))
    assert (task.running_return < 0).all()
    assert [str(each) for each in task.score] == ["0.0", "0.0"]


# What fails later.


FAULTS = {
    "reset": r"cannot reset: RuntimeError: no fuel",
    "step": r"cannot step: RuntimeError: no fuel",
    "shape": r": the observation must have 12 values, as its space has, and has 14\.",
    "scalar": r"cannot step: \w+: .*",
    "pay": r"cannot step: TypeError: .*NoneType.*",
    "info": r": info\['where'\] must have 2 values, as at first, and has 3\.",
    "one": r": info\['where'\] must have 2 values, as at first, and has 1\.",
    "text": r": info\['where'\] must have 2 values, as at first, and has 1\.",
    "success": r": info\['is_success'\] must be one truth value, and is array\(\[ True, False\]\)\.",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_an_environment_that_fails_later_is_one_line_that_names_it(fault):
    task = find(id="tests/Faulty-v0", position="where", kwargs={"fault": fault}).make(2)
    task.reset(np.arange(2), [0, 0])
    play(task, np.zeros((1, 3)))
    with pytest.raises(ConfigError, match=rf"^tests/Faulty-v0 ?{FAULTS[fault]}$") as caught:
        task.reset(np.array([1]), [3]) if fault == "reset" else play(task, np.zeros((1, 3)))
    assert "\n" not in str(caught.value)


def test_closing_closes_and_a_later_reset_begins_anew():
    task = start(2)
    task.close()
    task.reset(np.arange(2), range(2))
    assert_same_view(view(task), view(start(2)))


# Reading for an agent.


def test_an_agent_may_give_flat_own_and_batched_observations():
    reader = find().reader
    env = gymnasium.make("tests/Car-v0")
    observation, info = env.reset(seed=1)
    flat = gymnasium.spaces.flatten(env.observation_space, observation)
    for given, num_envs, is_single in ((observation, 1, True), (flat, 1, True), (flat[None], 1, False)):
        rows, single = reader.rows(given, num_envs)
        assert single == is_single
        assert_array_equal(rows, flat[None])
    envs = gymnasium.make_vec("tests/Car-v0", 3, vectorization_mode="sync")
    observations, infos = envs.reset(seed=1)
    rows, single = reader.rows(observations, 3)
    assert not single
    assert_array_equal(rows[0], flat)
    outside = find(position="where").reader
    assert_array_equal(outside.locate(rows, infos)[0], reader.locate(rows, None)[0])
    assert_array_equal(outside.locate(rows[:1], info)[0], rows[:1, 3:5])
    with pytest.raises(ConfigError, match=r"are in info \('where'\): agent\.act\(observation, info\)"):
        outside.locate(rows, None)
    with pytest.raises(ConfigError, match="info has no 'where' at this step"):
        outside.locate(rows[:1], {})


@pytest.mark.parametrize("wrong", [np.zeros(11), np.zeros((2, 12)), {"pose": np.zeros(3)}, None, "car"])
def test_what_is_no_observation_is_refused(wrong):
    with pytest.raises(ShapeError, match=r"this is no observation of|must be observations of 1 environments, got 2"):
        find().reader.rows(wrong, 1)


# What is wrong with a description.


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"id": "tests/Cra-v0"}, UnknownNameError, r"unknown Gymnasium environment 'tests/Cra-v0'\. Did you mean 'tes"),
        (
            {"id": "zzzzzz"},
            UnknownNameError,
            r"'zzzzzz'\. Known: \d+, none of them like it\. Is the package .*--import",
        ),
        ({"id": "os:Car-v0"}, ConfigError, r"id must be that .*without a module before it, got 'os:Car-v0'\. Import"),
        ({"id": "GymV21Environment-v0"}, ConfigError, r"id must be that of an environment in Gymnasium"),
        ({"id": 3}, ConfigError, r"id must be .* got 3\."),
        (
            {"position": [3, 12]},
            ConfigError,
            r"tests/Car-v0: position: 12 is out of range: there are 12 values, with indices from 0",
        ),
        ({"position": "10:13"}, ConfigError, r"position: '10:13' is out of range: there are 12 values"),
        ({"position": "pose[2:4]"}, ConfigError, r"position: 'pose\[2:4\]' is out of range: there are 3 values"),
        ({"heading": "pose[3]"}, ConfigError, r"heading: 'pose\[3\]' is out of range"),
        ({"position": "5:5"}, ConfigError, r"position: '5:5' is out of range"),
        (
            {"position": "place"},
            ConfigError,
            r"there is no 'place'\. The observation has keys 'gear', .*; info has 'is_",
        ),
        ({"primitive_view": "where"}, ConfigError, r"primitive_view: there is no 'where'\. The .* 'target', 'turn'\.$"),
        ({"proprioception": "x"}, ConfigError, r"proprioception: there is no 'x'"),
        ({"position": "name"}, ConfigError, r"position: info\['name'\] must hold numbers, and is 'car'"),
        ({"position": "pose"}, ConfigError, r"position must be 2 values, x and y; \('pose',\) are 3"),
        ({"position": ()}, ConfigError, r"position must say where x and y of the robot are"),
        ({"heading": "pose[0:2]"}, ConfigError, r"heading must be 1 value, the yaw, or 4, .* are 2"),
        ({"position": [0.5, 1]}, ConfigError, r"position must be indices or keys, for example .*; got \[0\.5, 1\]"),
        ({"position": [-1, 0]}, ConfigError, r"position must be indices or keys"),
        ({"position": {"x": 0}}, ConfigError, r"position must be indices or keys"),
        ({"position": "pose["}, ConfigError, r"position must be indices or keys"),
        ({"score": "best"}, UnknownNameError, r"unknown score 'best'\. Known: return, success"),
        ({"kwargs": {"nan_aftr": 1}}, ConfigError, r"tests/Car-v0 cannot be made: TypeError: .*nan_aftr"),
        ({"kwargs": {"render_mode": "human"}}, ConfigError, r"kwargs must not have 'render_mode': SHES sets it"),
        ({"kwargs": {"max_episode_steps": 3}}, ConfigError, r"must not have 'max_episode_steps'.* --horizon"),
        (
            {"kwargs": {"nan_after": {1}}},
            ConfigError,
            r"kwargs must be what JSON holds, .*set is not JSON serializable",
        ),
        ({"kwargs": 3}, ConfigError, r"kwargs must be arguments by name, got 3"),
        (
            {"id": "tests/Stepper-v0"},
            ConfigError,
            r"Stepper-v0: the action space must be a Box .*, and is Discrete\(4\)",
        ),
        ({"id": "tests/Unbounded-v0"}, ConfigError, r"the action space must be a Box of floats with finite bounds"),
        ({"id": "tests/Growing-v0"}, ConfigError, r"the observation space must have a fixed size, and is Sequence"),
        ({"id": "tests/Broken-v0"}, ConfigError, r"tests/Broken-v0 cannot reset or step: ZeroDivisionError: no road"),
        (
            {"position": [3, 3]},
            ConfigError,
            r"Car-v0: position must name every value once, got \[3, 3\], which are \[3, 3",
        ),
        (
            {"position": ["pose[0]", "3:4"]},
            ConfigError,
            r"position must name every value once, got \['pose\[0\]', '3:4'\], which are \[3, 3\]",
        ),
        ({"heading": ["turn[0:3]", "turn[2]"]}, ConfigError, r"heading must name every value once, got .*10, 10\]"),
        ({"proprioception": ["pose", 4]}, ConfigError, r"proprioception must name every value once"),
        ({"primitive_view": ["0:5", "pose"]}, ConfigError, r"primitive_view must name every value once"),
    ],
)
def test_what_does_not_fit_is_refused(changes, error, message):
    with pytest.raises(error, match=message):
        find(**changes)


def test_an_array_has_no_keys():
    with pytest.raises(ConfigError, match=r"there is no 'pose\b.*The observation has no keys: it is an array, use ind"):
        find(**{**POINT_MAZE, "position": "pose"})


@pytest.mark.parametrize(
    ("option", "flag"),
    [({"integrator": "rk4"}, "--integrator"), ({"target": (1.0, 2.0)}, "--target"), ({"spec": "hiro"}, "--spec")],
)
def test_options_of_our_own_environments_are_refused(option, flag):
    with pytest.raises(ConfigError, match=rf"tests/Car-v0 has no \w+, got .* Leave {flag} away; .*kwargs in its desc"):
        find().make(1, TaskOptions(**option))
    find().make(1, TaskOptions(reset_noise=0.0, evaluation=True))


def test_without_pictures_there_is_a_clear_error():
    task = start(1, id="tests/Silent-v0")
    with pytest.raises(ConfigError, match=r"Silent-v0 has no render mode 'rgb_array', so it cannot be drawn so\. It "):
        make_drawer(task, 64, 64)
    with pytest.raises(ConfigError, match=r"no render mode 'human', so it cannot be drawn so\. It has none\."):
        open_window(task)


def test_a_picture_that_fails_is_a_clear_error():
    task = start(1, id="tests/Dark-v0")
    make_drawer(task, 64, 64)
    task.reset(np.array([0]), [1])
    with pytest.raises(ConfigError, match=r"tests/Dark-v0 cannot be drawn: RuntimeError: no lamp"):
        task.pose(0)


@pytest.mark.parametrize("name", READY)
def test_without_the_extra_the_error_names_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", None)
    monkeypatch.delitem(gymnasium.registry, READY[name].id, raising=False)
    with pytest.raises(
        MissingExtraError, match=r"needs gymnasium_robotics, which is not installed .*'shes\[robotics\]'"
    ):
        ExternalEnvironment.find(READY[name])


# Names and files.


def test_a_registered_environment_is_known_by_its_name_and_may_be_registered_again():
    register_external_environment("car", **CAR)
    assert find_description("car") == ExternalDescription(**CAR)
    register_external_environment("car", **{**CAR, "position": [3, 4]})
    assert find_description("car").position == (3, 4)
    assert find_description("ant-gather") is None


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ant-gather", r"environment 'ant-gather' is one of our own already\. Choose another name"),
        ("robotics-ant-maze", r"environment 'robotics-ant-maze' comes with SHES: it is AntMaze_UMaze-v5\. Choose"),
        ("My Car", r"environment name must be lower-case words .* got 'My Car'"),
    ],
)
def test_a_taken_or_malformed_name_is_refused(name, message):
    with pytest.raises(ConfigError, match=message):
        register_external_environment(name, **CAR)


def test_a_name_of_an_external_environment_is_taken_for_our_own_too():
    register_external_environment("point-corner", **CAR)
    with pytest.raises(ConfigError, match=r"'point-corner' is Gymnasium's tests/Car-v0 already\. Choose another"):
        register_environment("point-corner", Point, Corner)


def test_a_description_comes_back_from_json_and_from_a_file(tmp_path):
    description = ExternalDescription(**{**CAR, "kwargs": {"nan_after": 5}})
    assert ExternalDescription.from_dict(description.to_dict()) == description
    file = tmp_path / "car.toml"
    file.write_text(
        'id = "tests/Car-v0"\nposition = "pose[0:2]"\nheading = "pose[2]"\nproprioception = "pose"\n'
        'primitive_view = ["gear", "pose"]\nkwargs = {nan_after = 5}\n'
    )
    assert read_description(file) == description


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("car.toml", "id = 'x", r"car\.toml, which is to describe an environment, cannot be read: "),
        ("car.json", "[1]", r"car\.json: the description of an environment must be values by name, got \[1\]"),
        ("car.json", '{"id": "x"}', r"car\.json: the description of an environment lacks 'position'"),
        ("car.json", '{"ID": "x"}', r"a description of an environment has no 'ID'\. It has id, position, heading, "),
        ("none.toml", None, r"none\.toml, which is to describe an environment, cannot be read: .*No such file"),
        (
            "car.toml",
            'id = "x"\nposition = 0\nscore = "best"',
            r"unknown score in .*car\.toml 'best'\. Known: return, suc",
        ),
    ],
)
def test_a_file_that_describes_nothing_is_refused(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        read_description(tmp_path / name)


@pytest.mark.parametrize(
    ("stem", "message"),
    [
        ("My car", r"environment name must be lower-case words .*, got 'My car'\. For example: 'my-own-2'\."),
        ("Car", r"environment name must be lower-case words .*, got 'Car'\. For example: 'my-own-2'\."),
        ("ant-maze", r"environment 'ant-maze' is one of our own already\. Choose another name\."),
        (
            "robotics-ant-maze",
            r"environment 'robotics-ant-maze' is Gymnasium's AntMaze_UMaze-v5 already, not tests/Car-v0\.",
        ),
    ],
)
def test_a_files_stem_is_the_environments_name(tmp_path, stem, message):
    file = tmp_path / f"{stem}.toml"
    file.write_text('id = "tests/Car-v0"\nposition = "where"\n')
    with pytest.raises(ConfigError, match=rf"{stem}\.toml: {message} The file's stem is the name: rename the file\."):
        read_description(file)


def test_a_file_may_describe_otherwise_what_its_name_stands_for(tmp_path):
    register_external_environment("car", **CAR)
    (tmp_path / "car.json").write_text('{"id": "tests/Car-v0", "position": "where"}')
    assert read_description(tmp_path / "car.json").position == ("where",)
