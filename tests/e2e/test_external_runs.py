"""Runs on environments of others: the same numbers on any worker, and a run folder that needs no other word."""

import json
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from PIL import Image

import shes
from shes.bench.measure import bench_rollout
from shes.cli import main
from shes.envs.external.description import ExternalDescription
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.errors import CheckpointError, ConfigError, UnknownNameError
from shes.es.streams import Purpose
from shes.training.evaluate import evaluation_seeds
from shes.training.presets import make_config
from shes.viewing.render import render
from shes.viewing.watch import watch
from tests.e2e import runs
from tests.envs.external_envs import CAR, register

pytestmark = pytest.mark.extras  # the fast tests have three minutes

TINY = {**runs.TINY, "horizon": 12, "evaluation_horizon": 15, "generations": 2, "controller_interval": 5}
WORDS = runs.flags(**{name: value for name, value in TINY.items() if name != "backend"})
MAZE = """
id = "shes/PointMaze-v0"
position = [0, 1]
proprioception = "0:4"
score = "success"
kwargs = {reset_noise = 0.0}
"""


@pytest.fixture(scope="module", autouse=True)
def registries():
    """The registries with the car in them; afterwards the tests' own environments are forgotten.

    Those of an imported package stay: they come with its first import alone.
    """
    known, described = set(gymnasium.registry), dict(EXTERNAL_ENVIRONMENTS)
    register()
    shes.register_external_environment("car", **CAR, kwargs={"terminates_after": 9})
    yield
    for env_id in set(gymnasium.registry) - known:
        if env_id.startswith("tests/"):
            del gymnasium.registry[env_id]
    EXTERNAL_ENVIRONMENTS.clear()
    EXTERNAL_ENVIRONMENTS.update(described)


@pytest.fixture(scope="module")
def run(tmp_path_factory, registries):
    return shes.train("car", out=tmp_path_factory.mktemp("car") / "run", **{**TINY, "generations": 3})


@pytest.fixture
def stranger(monkeypatch):
    """A process in which nobody has described the car."""
    monkeypatch.delitem(EXTERNAL_ENVIRONMENTS, "car")


@pytest.mark.parametrize("settings", [{"num_workers": 2}, {"num_workers": 2, "chunk_size": 3}])
def test_workers_find_the_numbers_of_one_process(run, tmp_path, settings):
    path = shes.train(
        "car", out=tmp_path / "run", **{**TINY, "generations": 3, "backend": "processes", **settings}
    ).path
    assert runs.differences(run.path, path) == []


def test_a_resumed_run_goes_on_as_if_it_had_never_stopped(run, tmp_path, stranger):
    path = shes.train("car", out=tmp_path / "run", external=run.config.run.external, **{**TINY, "generations": 1}).path
    shes.resume(path, generations=3)
    assert runs.differences(run.path, path) == []


def test_the_folder_holds_the_description(run):
    record = json.loads((run.path / "config.json").read_text())
    assert ExternalDescription.from_dict(record["config"]["external"]) == EXTERNAL_ENVIRONMENTS["car"]


def test_evaluation_loading_and_pictures_need_no_other_word(run, tmp_path, stranger):
    one, other = (shes.evaluate(run.path, episodes=4, num_workers=number) for number in (1, 2))
    assert one.summary() == other.summary()
    assert one.summary()["episode_steps_mean"] == 9
    with Image.open(render(run.path, tmp_path / "walk.gif", size=64, checkpoints=["0", "best"], steps=6)) as video:
        assert video.size == (128, 64)


def test_a_loaded_agent_plays_as_evaluation_does(run):
    evaluation = shes.evaluate(run.path, episodes=1, num_workers=1, seed=11)
    (seed,) = evaluation_seeds(11, 0, 1, Purpose.FRESH_EPISODES)
    agent = shes.load(run.path)
    env = gymnasium.make("tests/Car-v0", terminates_after=9, max_episode_steps=-1)
    observation, _ = env.reset(seed=seed % 2**31)
    earned, is_over = 0.0, False
    while not is_over:
        action = agent.act(observation)
        assert env.action_space.contains(action)
        observation, reward, terminated, truncated, _ = env.step(action)
        earned, is_over = earned + reward, terminated or truncated
    assert earned == evaluation.returns[0]
    assert agent.goal.shape == (1, 2)


def test_an_agent_acts_in_a_vector_environment(run):
    agents, agent = shes.load(run.path, num_envs=3), shes.load(run.path)
    envs = gymnasium.make_vec("tests/Car-v0", 3, vectorization_mode="sync")
    observations, _ = envs.reset(seed=4)
    actions = agents.act(observations)
    assert actions.shape == (3, 3)
    single, _ = gymnasium.make("tests/Car-v0").reset(seed=4)
    np.testing.assert_allclose(actions[0], agent.act(single), atol=1e-6)


def test_watching_uses_the_environments_own_window(run, monkeypatch):
    shown = []

    def show(self, pose, /, markers=(), *, is_new_episode=False):
        shown.append(is_new_episode)
        assert pose is None
        if len(shown) == 12:
            raise KeyboardInterrupt

    monkeypatch.setattr("shes.envs.external.task._OwnWindow.show", show)
    with pytest.raises(KeyboardInterrupt):
        watch(run.path)
    assert [number for number, is_new in enumerate(shown) if is_new] == [0, 10]


def test_a_camera_that_there_is_not_is_refused(run, tmp_path):
    with pytest.raises(ConfigError, match=r"this environment draws itself, and has no camera 'top'\. Leave --camera"):
        render(run.path, tmp_path / "walk.gif", camera="top")


def test_an_environment_of_this_script_goes_to_the_workers(tmp_path):
    """Registered in `__main__` alone: no worker could import it by name."""
    script = tmp_path / "own.py"
    text = (runs.Path(__file__).parents[1] / "envs" / "external_envs.py").read_text()
    script.write_text(
        f"{text}\nimport shes\nregister()\nshes.register_external_environment('car', **CAR)\n"
        f"print(shes.train('car', out='run', **{ {**TINY, 'backend': 'processes', 'num_workers': 2}!r}).generation)\n"
    )
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "2\n")


# On the command line.


@pytest.mark.extras
def test_a_file_is_all_that_the_command_line_needs(tmp_path):
    (tmp_path / "own-maze.toml").write_text(MAZE)
    for kind, settings in (("serial", ["--backend", "serial"]), ("two", ["--workers", "2"])):
        words = ["train", tmp_path / "own-maze.toml", *WORDS, *settings, "--out", tmp_path / kind]
        code, _, err = runs.run(*words)
        assert code == 0, err
    assert runs.differences(tmp_path / "serial", tmp_path / "two") == []
    (tmp_path / "own-maze.toml").unlink()
    code, _, err = runs.run("resume", tmp_path / "two", "--generations", "3")
    assert code == 0, err
    code, out, err = runs.run("evaluate", tmp_path / "two", "--episodes", "3", "--json")
    assert code == 0, err
    assert json.loads(out)["episodes"] == 3
    assert json.loads((tmp_path / "two" / "config.json").read_text())["config"]["env"] == "own-maze"


def test_python_takes_the_file_too(tmp_path):
    (tmp_path / "own-maze.json").write_text('{"id": "shes/PointMaze-v0", "position": [0, 1]}')
    config = make_config(str(tmp_path / "own-maze.json"), "smoke")
    assert (config.run.env, config.run.external) == (
        "own-maze",
        ExternalDescription(id="shes/PointMaze-v0", position=(0, 1)),
    )


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("maze.toml", 'id = "shes/PointMaze-v0"\nposition = [0, 9]', "position: 9 is out of range"),
        ("maze.toml", 'id = "shes/PointMaez-v0"\nposition = [0, 1]', "Did you mean 'shes/PointMaze-v0'"),
        ("ant-maze.toml", MAZE, "environment 'ant-maze' is one of our own already"),
        ("Maze.toml", MAZE, "environment name must be lower-case words"),
    ],
)
def test_a_wrong_file_is_one_line_and_leaves_no_folder(tmp_path, capsys, name, text, message):
    (tmp_path / name).write_text(text)
    assert main(["train", str(tmp_path / name), *WORDS, "--out", str(tmp_path / "run")]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_a_position_that_the_primitive_does_not_see_cannot_be_hidden(tmp_path):
    shes.register_external_environment("blind-car", **{**CAR, "primitive_view": "target"})
    message = r"hide_position: a primitive in blind-car sees no absolute position that could be .*Leave --hide-position"
    with pytest.raises(ConfigError, match=message):
        shes.train("blind-car", out=tmp_path / "run", **TINY, hide_position=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "sizes"),
    [
        ({"algorithm": "es"}, [12]),
        ({"hide_position": True}, [12, 3 + 6 - 2]),  # goal; gear and pose, of which two are the position
        ({"primitive_view": "proprioception", "clock_frequency": 1.0}, [12, 3 + 2 + 3]),
    ],
)
def test_the_levels_of_a_run_see_what_they_are_told_to(tmp_path, settings, sizes):
    tiny = {name: value for name, value in TINY.items() if name != "controller_interval"}
    path = shes.train("car", out=tmp_path / "run", **tiny, **settings).path
    levels = runs.state(path, "last").levels
    assert [len(level.statistics.total) for level in levels] == sizes


def test_a_primitive_that_learned_there_serves_there_again(run, tmp_path):
    path = shes.train("car", out=tmp_path / "run", primitive=run.path, **TINY).path
    before, after = (runs.state(each, name).levels[1] for each, name in ((run.path, "best"), (path, "last")))
    assert before.theta.tobytes() == after.theta.tobytes()
    with pytest.raises(
        ConfigError, match=r"It was trained on car: 9 inputs .*tests/Car-v0\[0\], .*\nHere there is: 28 "
    ):
        shes.train("point-gather", out=tmp_path / "other", primitive=run.path, goal_encoding="angle", **TINY)


def test_bench_rollout_has_no_bare_loop_of_it():
    with pytest.raises(ConfigError, match=r"bench rollout compares with MuJoCo alone, .* got car, which Gymnasium"):
        bench_rollout(make_config("car", "smoke"))


# A run folder of a stranger.


def changed(run, tmp_path, **changes):
    """Return a copy of the run folder whose description is another."""
    subprocess.run(["cp", "-r", run.path, tmp_path / "run"], check=True)
    file = tmp_path / "run" / "config.json"
    record = json.loads(file.read_text())
    record["config"]["external"] |= changes
    file.write_text(json.dumps(record))
    return tmp_path / "run"


@pytest.mark.parametrize("name", ["evil_module:Car-v0", "evil_module/Car-v0", "GymV26Environment-v0"])
def test_a_strangers_folder_imports_nothing(run, tmp_path, monkeypatch, name):
    (tmp_path / "evil_module.py").write_text("raise SystemExit('the stranger runs')")
    monkeypatch.syspath_prepend(tmp_path)
    path = changed(run, tmp_path, id=name, kwargs={"env_id": "evil_module:Car-v0"})
    for use in (shes.load, shes.resume, shes.evaluate):
        with pytest.raises((ConfigError, UnknownNameError, CheckpointError)):
            use(path)
    assert "evil_module" not in sys.modules


def test_a_checkpoint_of_another_description_is_refused(run, tmp_path):
    path = changed(run, tmp_path, kwargs={"terminates_after": 3})
    with pytest.raises(CheckpointError, match="is of another run: external is"):
        shes.load(path)


def test_our_own_names_cannot_be_described(run, tmp_path):
    path = changed(run, tmp_path)
    record = json.loads((path / "config.json").read_text())
    record["config"]["env"] = "ant-gather"
    (path / "config.json").write_text(json.dumps(record))
    with pytest.raises(ConfigError, match="environment 'ant-gather' is one of our own already"):
        shes.load(path)


# Gymnasium-Robotics.


@pytest.fixture
def robotics(monkeypatch):
    pytest.importorskip("gymnasium_robotics", reason="needs the extra: pip install 'shes[robotics]'")
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", ""))  # drawing sets it where it is empty


@pytest.mark.extras
@pytest.mark.parametrize(("name", "size"), [("robotics-ant-maze", (109, 8)), ("robotics-point-maze", (8, 2))])
def test_the_mazes_of_gymnasium_robotics_train_from_python(robotics, tmp_path, name, size):
    whole = shes.train(name, out=tmp_path / "whole", **{**TINY, "generations": 3})
    half = shes.train(name, out=tmp_path / "half", **{**TINY, "backend": "processes", "num_workers": 2})
    shes.resume(half.path, generations=3, num_workers=1)
    assert runs.differences(whole.path, half.path) == []
    one, other = (shes.evaluate(whole.path, episodes=3, num_workers=number).summary() for number in (1, 2))
    assert one == other
    agent = shes.load(whole.path)
    env = gymnasium.make(whole.config.run.external.id)
    observation, _ = env.reset(seed=1)
    action = agent.act(observation)
    assert (agent.observation_size, *action.shape) == size
    assert env.action_space.contains(action)
    assert np.abs(agent.goal - observation["achieved_goal"]).max() <= agent.config.hierarchy.goal_distance + 1e-6


@pytest.mark.extras
@pytest.mark.parametrize("name", ["robotics-ant-maze", "robotics-point-maze"])
def test_the_mazes_of_gymnasium_robotics_train_on_the_command_line(robotics, tmp_path, name):
    for kind, settings in (("serial", ["--backend", "serial"]), ("two", ["--workers", "2"])):
        code, _, err = runs.run("train", name, *WORDS, *settings, "--out", tmp_path / kind)
        assert code == 0, err
    assert runs.differences(tmp_path / "serial", tmp_path / "two") == []
    for words in (["resume", "--generations", "3"], ["evaluate", "--episodes", "2", "--json"]):
        code, out, err = runs.run(words[0], tmp_path / "two", *words[1:])
        assert code == 0, err
    assert json.loads(out)["episodes"] == 2


@pytest.mark.extras
@pytest.mark.parametrize("name", ["robotics-ant-maze", "robotics-point-maze"])
def test_an_episode_of_the_mazes_depends_on_its_seed_alone(robotics, name):
    def make(num_episodes):
        return shes.training.build.build_task(make_config(name, "smoke"), num_episodes, is_evaluation=False)

    alone, crowd = make(1), make(3)
    rng = np.random.default_rng(0)
    crowd.reset(np.arange(3), [1, 2, 3])
    for _ in range(20):
        crowd.step(np.arange(3), rng.uniform(-1, 1, (3, crowd.action_size)))
    alone.reset(np.array([0]), [77])
    crowd.reset(np.array([1]), [77])
    for _ in range(50):
        action = rng.uniform(-1, 1, (1, alone.action_size))
        alone.step(np.array([0]), action)
        crowd.step(np.array([1]), np.tile(action, (3, 1)))
        assert alone.observe()[0].tobytes() == crowd.observe()[1].tobytes()
        assert (alone.position[0], alone.heading[0]) == (pytest.approx(crowd.position[1]), crowd.heading[1])


@pytest.mark.extras
def test_a_maze_whose_physics_blows_up_diverges(robotics, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = shes.training.build.build_task(make_config("robotics-ant-maze", "smoke"), 2, is_evaluation=False)
    task.reset(np.arange(2), [1, 2])
    task._physics[1].qvel[0] = 1e12
    for _ in range(2):
        task.step(np.arange(2), np.zeros((2, 8)))
        assert task.diverged.tolist() == [False, True]
    assert np.isfinite(task.observe()).all()
    task.reset(np.array([1]), [2])
    task.step(np.arange(2), np.zeros((2, 8)))
    assert not task.diverged.any()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.extras
@pytest.mark.render
def test_a_video_of_a_maze(robotics, tmp_path):
    run = shes.train("robotics-point-maze", out=tmp_path / "run", **{**TINY, "generations": 1})
    with Image.open(render(run.path, tmp_path / "walk.gif", size=96, steps=10)) as video:
        assert video.size == (96, 96)
        assert np.asarray(video.convert("RGB")).std() > 10
