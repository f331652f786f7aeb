"""Runs on environments of others: the same numbers on any worker, and a run folder that keeps the name alone."""

import json
import os
import shutil
import signal
import sys
from functools import partial
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from PIL import Image

import shes
from shes.envs.named_environments import EXTERNAL_ENVIRONMENTS, INCLUDED
from shes.errors import ConfigError, ShesError
from shes.runs.evaluate import evaluation_seeds
from shes.streams import Purpose
from shes.viewing.playback import watch
from shes.viewing.render import render
from tests.e2e import runs
from tests.envs.external_envs import Car, locate_by_info, locate_car, register

pytestmark = pytest.mark.extras

TINY = {**runs.TINY, "horizon": 12, "evaluation_horizon": 15, "generations": 2, "controller_interval": 5}
SERIAL = {name: value for name, value in TINY.items() if name != "controller_interval"}


make_car = partial(Car, terminates_after=9)


@pytest.fixture(scope="module", autouse=True)
def registries():
    """The registries with the car in them; afterwards the tests' own environments are forgotten.

    Those of an imported package stay: they come with its first import alone.
    """
    known, named = set(gymnasium.registry), dict(EXTERNAL_ENVIRONMENTS)
    register()
    shes.register_external("car", make_car, locate=locate_car)
    yield
    for env_id in set(gymnasium.registry) - known:
        if env_id.startswith("tests/"):
            del gymnasium.registry[env_id]
    EXTERNAL_ENVIRONMENTS.clear()
    EXTERNAL_ENVIRONMENTS.update(named)


@pytest.fixture(scope="module")
def run(tmp_path_factory, registries):
    return shes.train("car", out=tmp_path_factory.mktemp("car") / "run", **{**TINY, "generations": 3})


def test_workers_and_a_resume_change_no_number(run, tmp_path):
    path = shes.train("car", out=tmp_path / "run", **{**TINY, "generations": 1}).path
    shes.resume(path, generations=3, backend="processes", num_workers=2, chunk_size=3)
    assert runs.differences(run.path, path) == []


def test_the_folder_keeps_the_name_and_it_must_be_registered_again(run, monkeypatch):
    assert json.loads((run.path / "config.json").read_text())["config"]["run"]["env"] == "car"
    monkeypatch.delitem(EXTERNAL_ENVIRONMENTS, "car")
    for use in (shes.load, shes.resume, shes.evaluate):
        with pytest.raises(ConfigError, match=r"unknown environment 'car'\..*shes\.register_external"):
            use(run.path)


def test_evaluation_and_pictures(run, tmp_path):
    one, other = (shes.evaluate(run.path, episodes=4, num_workers=number) for number in (1, 2))
    assert one.summary() == other.summary()
    assert one.summary()["episode_steps_mean"] == 9
    with Image.open(render(run.path, tmp_path / "walk.gif", size=64, checkpoints=["0", "best"], steps=6)) as video:
        assert video.size == (128, 64)


def test_a_loaded_agent_plays_as_evaluation_does(run):
    evaluation = shes.evaluate(run.path, episodes=1, num_workers=1, seed=11)
    (seed,) = evaluation_seeds(11, 0, 1, Purpose.FRESH_EPISODES)
    agent = shes.load(run.path)
    env = make_car()
    observation, _ = env.reset(seed=seed % 2**31)
    earned, is_over = 0.0, False
    while not is_over:
        action = agent.act(observation)
        assert env.action_space.contains(action)
        observation, reward, terminated, truncated, _ = env.step(action)
        earned, is_over = earned + reward, terminated or truncated
    assert earned == evaluation.returns[0]
    assert agent.goal.shape == (1, 2)


def test_an_agent_of_goals_may_need_info_or_the_environment(run, tmp_path):
    shes.register_external("told-car", make_car, locate=locate_by_info)
    agent = shes.load(shes.train("told-car", out=tmp_path / "car", **TINY).path)
    env = make_car()
    observation, info = env.reset(seed=1)
    with pytest.raises(ConfigError, match=r"agent\.act\(observation, info\)"):
        agent.act(observation)
    assert env.action_space.contains(agent.act(observation, info))
    assert agent.act(*gymnasium.vector.SyncVectorEnv([make_car]).reset(seed=1)).shape == (1, 3)
    agent = shes.load(shes.train("gymnasium:Ant-v5", out=tmp_path / "ant", **TINY).path)
    env = gymnasium.make("Ant-v5")
    observation, info = env.reset(seed=1)
    with pytest.raises(ConfigError, match=r"agent\.act\(observation, env=env\)"):
        agent.act(observation, info)
    assert env.action_space.contains(agent.act(observation, env=env))
    assert np.abs(agent.goal - env.unwrapped.data.qpos[:2]).max() <= agent.config.hierarchy.goal_distance + 1e-6


def test_watching_uses_the_environments_own_window(run, monkeypatch):
    shown = []

    def show(self, pose, /, markers=(), *, is_new_episode=False, lines=()):
        shown.append(is_new_episode)
        assert pose is None
        if len(shown) == 12:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "glfw", SimpleNamespace(init=lambda: True))  # there is a screen
    monkeypatch.setattr("shes.drawing.window.PassthroughWindow.show", show)
    with pytest.raises(KeyboardInterrupt):
        watch(run.path)
    assert [number for number, is_new in enumerate(shown) if is_new] == [0, 10]


def test_a_camera_that_there_is_not_is_refused(run, tmp_path):
    with pytest.raises(ConfigError, match=r"this environment draws itself and has no camera 'top'\. Omit --camera"):
        render(run.path, tmp_path / "walk.gif", camera="top")


@pytest.mark.parametrize(
    ("env", "settings", "sizes"),
    [
        ("car", {"algorithm": "es"}, [8]),
        ("car", {}, [8, 3 + 6]),  # goal; gear and pose, not the desired goal
        ("car", {"primitive_view": "proprioception", "clock_frequency": 1.0}, [8, 3 + 2 + 6]),
        ("blind-car", {}, [8, 3 + 2]),
    ],
)
def test_the_levels_of_a_run_see_what_they_are_told_to(tmp_path, env, settings, sizes):
    shes.register_external("blind-car", make_car, locate=locate_car, primitive_view=[0, 1])
    levels = runs.state(shes.train(env, out=tmp_path / "run", **SERIAL, **settings).path).levels
    assert [len(level.statistics.total) for level in levels] == sizes


def test_goals_without_a_position_are_refused_and_leave_no_folder(tmp_path):
    message = r"the position of the robot of gymnasium:tests/Car-v0 is unknown.*--algorithm es"
    with pytest.raises(ConfigError, match=message):
        shes.train("gymnasium:tests/Car-v0", out=tmp_path / "run", **SERIAL)
    assert list(tmp_path.iterdir()) == []


def test_a_primitive_that_learned_there_serves_there_again(run, tmp_path):
    path = shes.train("car", out=tmp_path / "run", primitive=run.path, **TINY).path
    before, after = (runs.state(each, name).levels[1] for each, name in ((run.path, "best"), (path, "last")))
    assert before.theta.tobytes() == after.theta.tobytes()
    with pytest.raises(ConfigError, match="it was trained on car for an external robot, but point-gather has the p"):
        shes.train("point-gather", out=tmp_path / "other", primitive=run.path, goal_encoding="angle", **TINY)


# Gymnasium's own, on the command line.


def test_an_id_of_gymnasium_is_all_that_the_command_line_needs(tmp_path):
    """Actions are discrete, the time limit is its own, and the kill finds it inside a generation."""
    words = ["gymnasium:CartPole-v1", "--algorithm", "es", *runs.flags(**{**SERIAL, "horizon": 60, "generations": 6})]
    code, _, err = runs.run("train", *words, "--out", tmp_path / "serial")
    assert code == 0, err
    process = runs.start("train", *words, "--backend", "processes", "--workers", "2", "--out", tmp_path / "killed")
    runs.stop_inside_generation(process, tmp_path / "killed", 2)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    code, _, err = runs.run("resume", tmp_path / "killed")
    assert code == 0, err
    assert runs.differences(tmp_path / "serial", tmp_path / "killed") == []
    observation, _ = gymnasium.make("CartPole-v1").reset(seed=1)
    assert shes.load(tmp_path / "killed").act(observation) in (0, 1)


@pytest.mark.parametrize("name", ["evil_module:Car-v0", "GymV26Environment-v0"])
def test_a_strangers_folder_imports_nothing(run, tmp_path, monkeypatch, name):
    (tmp_path / "evil_module.py").write_text("raise SystemExit('the stranger runs')")
    monkeypatch.syspath_prepend(tmp_path)
    file = shutil.copytree(run.path, tmp_path / "run") / "config.json"
    file.write_text(file.read_text().replace('"car"', f'"gymnasium:{name}"'))
    for use in (shes.load, shes.resume, shes.evaluate):
        with pytest.raises(ShesError):
            use(tmp_path / "run")
    assert "evil_module" not in sys.modules


# Gymnasium-Robotics.


@pytest.mark.parametrize(("name", "size"), [("robotics-ant-maze", (109, 8)), ("robotics-point-maze", (8, 2))])
def test_the_mazes_of_gymnasium_robotics_train_from_python(tmp_path, monkeypatch, name, size):
    pytest.importorskip("gymnasium_robotics", reason="needs the extra: pip install 'shes[robotics]'")
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", ""))  # drawing sets it where it is empty
    whole = shes.train(name, out=tmp_path / "whole", **{**TINY, "generations": 3})
    half = shes.train(name, out=tmp_path / "half", **{**TINY, "backend": "processes", "num_workers": 2})
    shes.resume(half.path, generations=3, num_workers=1)
    assert runs.differences(whole.path, half.path) == []
    agent = shes.load(whole.path)
    env = gymnasium.make(INCLUDED[name].source)
    observation, _ = env.reset(seed=1)
    action = agent.act(observation)
    assert (agent.observation_size, *action.shape) == size
    assert env.action_space.contains(action)
    assert np.abs(agent.goal - observation["achieved_goal"]).max() <= agent.config.hierarchy.goal_distance + 1e-6
