"""Runs of a robot from its file: trained, moved elsewhere without the file, resumed, exported, compared."""

import json
import runpy
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal

import shes
from shes.cli import main
from shes.errors import CheckpointError, ConfigError
from shes.runs.make_config import make_config
from shes.viewing.playback import Playback
from tests.e2e import runs
from tests.envs.robot_files import ASSETS, walker

EXAMPLE = Path(__file__).parents[2] / "examples" / "run_exported.py"
SERVO = '<position joint="{}" kp="20" timeconst=".02"/>'
TASKS = ("flagrun", "gather", "maze", "push", "fall")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Path of a robot with six legs and filtered position servos; not to be changed."""
    path = tmp_path_factory.mktemp("robot") / "hexapod.xml"
    path.write_text(walker(6, actuator=SERVO, trunk='<light pos="0 0 2" mode="trackcom"/>'))
    return path


@pytest.fixture(scope="module")
def trained(robot, tmp_path_factory):
    """Folder of a finished run of it; not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("trained") / "run", "flagrun", robot=str(robot))


def test_a_run_goes_on_elsewhere_and_without_the_file(robot, trained, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    file = shutil.copy(robot, folder / "hexapod.xml")
    half = runs.train_tiny(folder / "run", "flagrun", robot=str(file), generations=2)
    shutil.move(half, tmp_path / "moved")
    shutil.rmtree(folder)
    assert shes.resume(tmp_path / "moved", generations=4).path == tmp_path / "moved"
    assert runs.differences(tmp_path / "moved", trained) == []
    assert_array_equal(*(shes.evaluate(path, episodes=2).scores for path in (tmp_path / "moved", trained)))


def test_the_number_of_workers_changes_no_number(robot, trained, tmp_path):
    again = runs.train_tiny(tmp_path / "two", "flagrun", robot=str(robot), backend="processes", num_workers=2)
    assert runs.differences(again, trained) == []


@pytest.mark.parametrize("env", ["flagrun", "gather"])
def test_an_exported_agent_acts_as_ours(robot, trained, tmp_path, env):
    own = {"controller_view": "sectors", "controller_output": "heading_vector", "generations": 1}
    path = trained if env == "flagrun" else runs.train_tiny(tmp_path / "run", env, primitive=str(trained), **own)
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported = runpy.run_path(str(EXAMPLE), run_name="run_exported")["ExportedAgent"](file)
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
    own = {"generations": 1, "horizon": 6, "evaluation_horizon": 6, "evaluation_interval": 1}
    path = runs.train_tiny(tmp_path / "run", env, robot=str(ASSETS / "humanoid.xml"), **own)
    assert np.isfinite(shes.evaluate(path, episodes=2).scores).all()


def test_a_primitive_brings_its_robot(robot, trained, tmp_path, monkeypatch):
    config = make_config("gather", "smoke", {"primitive": str(trained)})
    assert config.values["robot"] == str(trained / "robot" / "hexapod.zip")
    assert make_config("gather", "smoke", {"primitive": str(trained), "robot": str(robot)}).values["robot"] == str(
        robot
    )
    other = tmp_path / "hexapod.xml"  # the same name and the same joints
    other.write_text(walker(6, actuator=SERVO, trunk='<geom size=".05" pos="0 0 .1"/>'))
    with pytest.raises(
        ConfigError, match=r"trained on flagrun for the robot hexapod \(.*, but gather has the robot hex"
    ):
        make_config("gather", "smoke", {"primitive": str(trained), "robot": str(other)})


def test_runs_of_two_robots_are_not_repetitions(robot, trained, tmp_path):
    other = tmp_path / "hexapod.xml"
    other.write_text(walker(6, actuator=SERVO, trunk='<geom size=".05" pos="0 0 .1"/>'))
    one = runs.train_tiny(tmp_path / "one", "flagrun", robot=str(other), seed=6)
    same = runs.train_tiny(tmp_path / "same", "flagrun", robot=str(robot), seed=6)
    numbers = [shes.load(path).config.numbers() for path in (trained, same, one)]
    assert numbers[0]["robot"] == numbers[1]["robot"] != numbers[2]["robot"]
    assert {each["robot"].split()[0] for each in numbers} == {"hexapod"}
    shutil.copy(one / "robot" / "hexapod.zip", same / "robot" / "hexapod.zip")
    with pytest.raises(CheckpointError, match="robot is 'hexapod"):
        shes.load(same)


@pytest.mark.parametrize("body", ["ant", "point"])
def test_ant_and_point_are_robots_with_names(body):
    own, named = make_config(f"{body}-gather", "laptop"), make_config("gather", "laptop", {"robot": body})
    assert named.to_dict() == own.to_dict()
    env = gymnasium.make("shes/Gather-v0", robot=body)
    assert (env.unwrapped.task.body.name, env.observation_space) == (
        body, gymnasium.make(f"shes/{body.title()}Gather-v0").observation_space,
    )  # fmt: skip


def test_gymnasium_makes_a_robot_alone_and_many(robot):
    env = gymnasium.make("shes/Flagrun-v0", robot=str(robot))
    with pytest.warns(UserWarning, match="infinity"):
        check_env(env.unwrapped, skip_render_check=True)
    many = gymnasium.make_vec("shes/Flagrun-v0", num_envs=3, robot=str(robot))
    first = many.reset(seed=[5, 6, 7])[0]
    assert_array_equal(first[1], env.reset(seed=6)[0])
    actions = np.tile(np.linspace(-1, 1, 12, dtype=np.float32), (3, 1))
    assert_array_equal(many.step(actions)[0][1], env.step(actions[0])[0])
    with pytest.raises(ConfigError, match="which robot"):
        gymnasium.make("shes/Flagrun-v0")


@pytest.mark.parametrize("algorithm", ["hiro", "td3", "es"])
def test_other_algorithms_are_configured_for_a_robot(robot, algorithm):
    config = make_config("gather", "smoke", {"algorithm": algorithm, "robot": str(robot)})
    assert (config.run.algorithm, config.values["robot"]) == (algorithm, str(robot))


REFUSED = {
    "no robot": (["gather"], "which robot?"),
    "a folder": (["gather", "--robot", "."], "robot '.' is no file"),
    "of an environment with its own": (
        ["ant-gather", "--robot", "r.xml"],
        "Name the task: gather --robot",
    ),
    "motors twice": (["flagrun", "--robot", "r.xml", "--motors", "3"], "Omit --motors"),
    "lying": (["flagrun", "--robot", "lying.xml"], "lies in its home pose"),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_trained_writes_nothing(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    for name, turn in (("r", "1 0 0 0"), ("lying", "1 1 0 0")):
        Path(f"{name}.xml").write_text(walker(6, place=f'pos="0 0 .5" quat="{turn}"'))
    assert main(["train", *words, "--preset", "smoke", "--out", "run"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lying.xml", "r.xml"]


def test_the_command_says_what_it_understood(robot, capsys):
    assert main(["envs", "--robot", str(robot), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["symmetry"].startswith("6 turns (difference ")
    assert facts["root"].startswith("trunk, 12 joints")
    assert main(["envs", "--robot", str(robot)]) == 0
    assert all(f"{name}: {text}" in capsys.readouterr().out for name, text in list(facts.items())[:1])
    assert main(["envs", "--robot", "ant"]) == 2
    assert "comes with SHES" in capsys.readouterr().err


def test_a_run_names_its_robot(trained, capsys):
    assert main(["info", str(trained), "--json"]) == 0
    assert "hexapod" in json.loads(capsys.readouterr().out)["robot"]


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
