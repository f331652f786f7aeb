"""Runs of a robot from its file: trained, moved elsewhere without the file, resumed, exported, compared."""

import json
import re
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal

import shes
from shes.cli import main
from shes.envs.gymnasium_ids import TASKS
from shes.errors import CheckpointError, ConfigError
from shes.runs.make_config import make_config
from shes.viewing.playback import Playback
from tests.e2e import runs
from tests.envs.robot_files import ASSETS, FILTER, walker
from tests.runs.test_export import run_exported


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Path of a robot with six legs and filtered position servos; not to be changed."""
    path = tmp_path_factory.mktemp("robot") / "hexapod.xml"
    path.write_text(walker(6, actuator=FILTER, trunk='<light pos="0 0 2" mode="trackcom"/>'))
    return path


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Path of another robot, of the same name and with the same joints."""
    path = tmp_path_factory.mktemp("other") / "hexapod.xml"
    path.write_text(walker(6, actuator=FILTER, trunk='<geom size=".05" pos="0 0 .1"/>'))
    return path


@pytest.fixture(scope="module")
def trained(robot, tmp_path_factory):
    """Folder of a finished run of the robot; not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("trained") / "run", "flagrun", robot=str(robot))


def test_a_run_goes_on_elsewhere_and_without_the_file(robot, trained, tmp_path):
    """Two workers begin it, and one ends it."""
    folder = tmp_path / "folder"
    folder.mkdir()
    copy = str(shutil.copy(robot, folder))
    two = {"generations": 2, "backend": "processes", "num_workers": 2}
    half = runs.train_tiny(folder / "run", "flagrun", robot=copy, **two)
    moved = Path(shutil.move(half, tmp_path / "moved"))
    shutil.rmtree(folder)
    assert shes.resume(moved, generations=4, backend="serial").path == moved
    assert runs.differences(moved, trained) == []
    assert_array_equal(*(shes.evaluate(path, episodes=2).scores for path in (moved, trained)))


@pytest.mark.parametrize("env", ["flagrun", "gather"])
def test_an_exported_agent_acts_as_ours(robot, trained, tmp_path, env):
    own = {"controller_view": "sectors", "controller_output": "heading_direction", "generations": 1}
    path = trained if env == "flagrun" else runs.train_tiny(tmp_path / "run", env, primitive=str(trained), **own)
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported = run_exported.ExportedAgent(file)
    agent = shes.load(path)
    env = gymnasium.make(f"shes/{env.title()}-v0", robot=str(robot), max_episode_steps=60)
    observation, _ = env.reset(seed=3)
    actions = []
    for _ in range(40):
        actions.append(agent.act(observation))
        given = {} if "controller" in exported.spec else {"goal": agent.goal[0]}
        assert_allclose(exported.act(observation, **given), actions[-1], atol=1e-6)  # a goal is rounded to metres
        observation = env.step(actions[-1])[0]
    assert len(np.unique(actions, axis=0)) > 20
    assert_allclose(exported.spec["control_map"], [[0] * 12, np.deg2rad([20, 25] * 6)], rtol=1e-5)


@pytest.mark.parametrize("env", TASKS)
def test_every_task_takes_a_robot_of_gymnasium(tmp_path, env):
    own = {"generations": 1, "horizon": 6, "evaluation_horizon": 6, "evaluation_interval": 1, "population_size": 4}
    path = runs.train_tiny(tmp_path / "run", env, robot=str(ASSETS / "humanoid.xml"), **own)
    assert np.isfinite(shes.evaluate(path, episodes=2).scores).all()


def test_a_primitive_brings_its_robot(robot, trained, other):
    for asked, own in (({}, trained / "robot" / "hexapod.zip"), ({"robot": str(robot)}, robot)):
        config = make_config("gather", "smoke", {"primitive": str(trained), **asked})
        assert config.values["robot"] == str(own)
    with pytest.raises(ConfigError, match=r"on flagrun for the robot hexapod .*, but gather has the robot hex"):
        make_config("gather", "smoke", {"primitive": str(trained), "robot": str(other)})


def test_runs_of_two_robots_are_not_repetitions(robot, trained, other, tmp_path):
    paths = [trained]
    for path in (robot, other):
        paths.append(runs.train_tiny(tmp_path / path.parent.name, "flagrun", robot=str(path), seed=6, generations=1))
    numbers = [shes.load(path).config.numbers() for path in paths]
    assert numbers[0]["robot"] == numbers[1]["robot"] != numbers[2]["robot"]
    assert {each["robot"].split()[0] for each in numbers} == {"hexapod"}
    shutil.copy(paths[2] / "robot" / "hexapod.zip", paths[1] / "robot" / "hexapod.zip")
    with pytest.raises(CheckpointError):
        shes.load(paths[1])


def test_robots_have_names_algorithms_and_environments(robot):
    for body in ("ant", "point"):
        own, named = make_config(f"{body}-gather", "laptop"), make_config("gather", "laptop", {"robot": body})
        assert named.to_dict() == own.to_dict()
        env, twin = gymnasium.make("shes/Gather-v0", robot=body), gymnasium.make(f"shes/{body.title()}Gather-v0")
        assert (env.unwrapped.task.body.name, env.observation_space) == (body, twin.observation_space)
    for algorithm in ("hiro", "td3", "es"):
        config = make_config("gather", "smoke", {"algorithm": algorithm, "robot": str(robot)})
        assert (config.run.algorithm, config.values["robot"]) == (algorithm, str(robot))
    env = gymnasium.make("shes/Flagrun-v0", robot=str(robot))
    with pytest.warns(UserWarning, match="infinity"):
        check_env(env.unwrapped, skip_render_check=True)
    many = gymnasium.make_vec("shes/Flagrun-v0", num_envs=3, robot=str(robot))
    first = many.reset(seed=[5, 6, 7])[0]
    assert_array_equal(first[1], env.reset(seed=6)[0])
    actions = np.tile(np.linspace(-1, 1, 12, dtype=np.float32), (3, 1))
    assert_array_equal(many.step(actions)[0][1], env.step(actions[0])[0])
    with pytest.raises(ConfigError):
        gymnasium.make("shes/Flagrun-v0")


TRAIN = ("train", "--preset", "smoke", "--out", "run")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*TRAIN, "gather"), "which robot?"),
        ((*TRAIN, "gather", "--robot", "."), "robot '.' is no file"),
        ((*TRAIN, "ant-gather", "--robot", "hexapod.xml"), "Name the task: gather --robot"),
        ((*TRAIN, "flagrun", "--robot", "hexapod.xml", "--motors", "3"), "Omit --motors"),
        ((*TRAIN, "flagrun", "--robot", "lying.xml"), "lies in its home pose"),
        (("envs", "--robot", "ant"), "comes with SHES"),
    ],
)
def test_what_cannot_be_used_writes_nothing(robot, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    shutil.copy(robot, tmp_path)
    Path("lying.xml").write_text(walker(6, place='pos="0 0 .5" quat="1 1 0 0"'))
    assert main([*words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hexapod.xml", "lying.xml"]


def test_commands_say_what_they_understood(robot, trained, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def printed(*words):
        assert main([*words]) == 0
        return capsys.readouterr().out

    facts = json.loads(printed("envs", "--robot", str(robot), "--json"))
    assert facts["symmetry"].startswith("6 turns (difference ")
    assert facts["root"].startswith("trunk, 12 joints")
    assert facts["size"].startswith("0.42 of the ant's")
    assert f"root: {facts['root']}" in printed("envs", "--robot", str(robot))
    assert facts["at rest"] == "with outputs of 0 it stands for 2 s or longer"
    assert re.search(
        r"at rest: with outputs of 0 it falls after 0.\d+ s\n", printed("envs", "--robot", str(ASSETS / "humanoid.xml"))
    )
    Path("stiff.xml").write_text(walker(4, actuator='<position joint="{}" kp="1e9"/>'))
    assert "at rest: with outputs of 0 its physics diverges after 0.0" in printed("envs", "--robot", "stiff.xml")
    assert "hexapod" in json.loads(printed("info", str(trained), "--json"))["robot"]


@pytest.mark.render
@pytest.mark.parametrize("env", TASKS)
def test_pictures_show_a_robot_at_its_scale(robot, env):
    """The robot, whose colour no other thing has, fills as much of a picture as the ant does: about a hundredth."""
    shares = []
    for name in (str(robot), "ant"):
        made = gymnasium.make(f"shes/{env.title()}-v0", robot=name, render_mode="rgb_array", width=240, height=240)
        made.reset(seed=1)
        picture = made.render().astype(int)
        red, green, blue = picture.reshape(-1, 3).T
        shares.append(np.mean((red > green + 30) & (red > blue + 30)))
        made.close()
        assert np.median(picture) < 240  # the robot's own light is off
    assert shares[0] == pytest.approx(shares[1], rel=0.7)
    assert shares[0] > 0.002


def test_the_goal_is_drawn_where_the_task_has_it(trained):
    played = Playback(trained, "last")
    step = next(played.play(3))
    discs = [each.position[:2] for each in step.markers if each.shape == "disc"]
    assert_allclose(discs[-1], played.task.markers(0)[0].position[:2])
    played.task.close()
