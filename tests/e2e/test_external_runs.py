"""Runs on environments of others: the same numbers on any worker, and a run folder that keeps the name alone."""

import json
import os
import shutil
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
from tests.envs.external_envs import Body, Car, locate_by_info, locate_car, registered
from tests.messages import raises

pytestmark = pytest.mark.extras

FLAT = {**runs.TINY, "horizon": 12, "evaluation_horizon": 15, "generations": 2}
TINY = {**FLAT, "controller_interval": 5}
ROBOTICS = "needs the extra: pip install 'shes[robotics]'"

make_car = partial(Car, terminates_after=9)


@pytest.fixture(scope="module", autouse=True)
def registries():
    """The registries with the car in them."""
    with registered():
        shes.register_external("car", make_car, locate=locate_car)
        yield


@pytest.fixture(scope="module")
def run(tmp_path_factory, registries):
    return shes.train("car", out=tmp_path_factory.mktemp("car") / "run", **TINY)


@pytest.mark.parametrize(
    ("name", "make", "settings"),
    [
        ("car", make_car, TINY),
        ("gymnasium:CartPole-v1", "CartPole-v1", {**FLAT, "algorithm": "es", "horizon": 60}),
        *((name, INCLUDED[name].source, TINY) for name in ("robotics-ant-maze", "robotics-point-maze")),
    ],
)
def test_workers_and_a_resume_change_no_number(tmp_path, monkeypatch, name, make, settings):
    if name in INCLUDED:
        pytest.importorskip("gymnasium_robotics", reason=ROBOTICS)
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", ""))  # drawing sets it where it is empty
    whole, half = tmp_path / "whole", tmp_path / "half"
    shes.train(name, out=whole, **settings)
    shes.train(name, out=half, **{**settings, "generations": 1})
    shes.resume(half, generations=2, backend="processes", num_workers=2, chunk_size=3)
    assert runs.differences(whole, half) == []
    agent, env = shes.load(whole), gymnasium.make(make) if isinstance(make, str) else make()
    observation, _ = env.reset(seed=1)
    assert env.action_space.contains(agent.act(observation))
    if name in INCLUDED:
        assert np.abs(agent.goal - observation["achieved_goal"]).max() <= agent.config.hierarchy.goal_distance + 1e-6


def test_the_folder_keeps_a_name_that_must_be_registered_again(run, monkeypatch):
    assert json.loads((run.path / "config.json").read_text())["config"]["run"]["env"] == "car"
    monkeypatch.delitem(EXTERNAL_ENVIRONMENTS, "car")
    for use in (shes.load, shes.resume, shes.evaluate):
        with raises(ConfigError, "unknown environment 'car'. ... shes.register_external"):
            use(run.path)


def test_evaluation_and_pictures(run, tmp_path):
    one, other = (shes.evaluate(run.path, episodes=4, num_workers=number) for number in (1, 2))
    assert one.summary() == other.summary()
    assert one.summary()["episode_steps_mean"] == 9
    with Image.open(render(run.path, tmp_path / "walk.gif", size=64, checkpoints=["0", "best"], steps=6)) as video:
        assert video.size == (128, 64)
    with raises(ConfigError, "this environment draws itself and has no camera 'top'. Omit --camera"):
        render(run.path, tmp_path / "walk.gif", camera="top")


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
    assert env.action_space.contains(agent.act(*env.reset(seed=1)))
    assert agent.act(*gymnasium.vector.SyncVectorEnv([make_car]).reset(seed=1)).shape == (1, 3)
    shes.register_external("free-body", partial(Body, "<freejoint/>"))
    agent, env = shes.load(shes.train("free-body", out=tmp_path / "body", **TINY).path), Body("<freejoint/>")
    assert env.action_space.contains(agent.act(env.reset(seed=1)[0], env=env))
    assert np.abs(agent.goal - env.data.qpos[:2]).max() <= agent.config.hierarchy.goal_distance + 1e-6


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


def test_a_primitive_that_learned_there_serves_there_again(run, tmp_path):
    path = shes.train("car", out=tmp_path / "run", primitive=run.path, **TINY).path
    before, after = (runs.state(each, name).levels[1] for each, name in ((run.path, "best"), (path, "last")))
    assert before.theta.tobytes() == after.theta.tobytes()
    with raises(ConfigError, "it was trained on car for an external robot, but point-gather has the p"):
        shes.train("point-gather", out=tmp_path / "other", primitive=run.path, goal_encoding="angle", **TINY)


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
