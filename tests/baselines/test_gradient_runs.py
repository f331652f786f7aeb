"""Runs of HIRO and TD3: settings, errors, equal numbers, checkpoints, and agents that act without JAX."""

import itertools
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

import shes
from shes.baselines.collector import Actor
from shes.baselines.learner_settings import HIRO_SECTIONS
from shes.baselines.td3 import LEARNING, TD3State
from shes.cli import main
from shes.envs.markers import GOAL
from shes.errors import CheckpointError, ConfigError, DivergenceError, MissingExtraError
from shes.runs.build import build_algorithm, open_run
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from shes.settings import setting_fields
from shes.viewing.playback import Playback
from tests.e2e import runs
from tests.runs.test_export import OnnxAgent, episode, run_exported

TINY = {
    "preset": "smoke",
    "seed": 5,
    "hidden": (6,),
    "horizon": 20,
    "generations": 4,
    "evaluation_interval": 2,
    "evaluation_episodes": 3,
    "keep_checkpoints": 2,
    "backend": "serial",
    "warmup_steps": 60,
    "generation_steps": 60,
    "batch_size": 5,
    "replay_size": 100,
}
needs_jax = pytest.mark.hiro
over_algorithms = pytest.mark.parametrize("name", ["hiro", "td3"])


def build(name="hiro", env="point-gather", **settings):
    values = {**TINY, "algorithm": name, **settings}
    return build_algorithm(make_config(env, values.pop("preset"), values))


def train(path, name="hiro", env="point-gather", **settings):
    return shes.train(env, out=path, **{**TINY, "algorithm": name, **settings}).path


@pytest.fixture
def untrained(tmp_path):
    """Return a function that makes the folder of a run of 0 generations, without JAX."""

    def make(name, env, **settings):
        learner, folder = build(name, env, **settings), RunFolder.create(tmp_path / f"{name}-{env}")
        rng, config = np.random.default_rng(1), learner.problem.settings
        state = TD3State(seed=5, generation=0, env_steps=0, learners=tuple(each.start(rng) for each in learner.levels))
        arrays = learner.to_arrays(state)
        for level in learner.level_names:  # an initial actor does next to nothing
            arrays[f"{level}/actor"] = rng.normal(0, 0.3, arrays[f"{level}/actor"].shape).astype(np.float32)
        with folder.lock():
            for checkpoint in ("best", "last"):
                saved = Checkpoint(arrays=arrays, best=Best(), numbers=config.numbers())
                save_checkpoint(folder.checkpoint_path(checkpoint), saved)
            folder.record_start(config, {})
        return folder.path

    return make


# Settings and errors.


def due(level):
    """Return what counts the updates of a level in 60 steps, by call."""
    return lambda a: [count for name, count in a.updates_due(0, 60) if name == level]


SEEN = {
    # setting: (value, what reads it, what that finds)
    "hidden": ((9, 8), lambda a: [level.actor.sizes[1:-1] for level in a.levels], [(9, 8)] * 2),
    "replay_size": (777, lambda a: [level.replay.capacity for level in a.levels], [777, 777]),
    "exploration_noise": (0.5, lambda a: a.levels[1].exploration_std.tolist(), [0.5, 0.5]),
    "goal_noise": (0.5, lambda a: a.levels[0].exploration_std.tolist(), [5.0, 5.0]),
    "normalise_inputs": (False, lambda a: (a.design.input_clip, a.settings.input_clip), (np.inf, np.inf)),
    "warmup_steps": (90_000, lambda a: a.levels[0].replay.slack, 90_020),
    "generation_steps": (80_000, lambda a: (a.levels[0].replay.slack, a.steps_per_generation(a.problem.settings)),
                         (80_020, 80_000)),
    "update_interval": (20, due("primitive"), [20, 20, 20]),
    "controller_update_interval": (30, due("controller"), [1, 1]),
    "controller_interval": (4, lambda a: a.design.controller_interval, 4),
    "goal_distance": (3.0, lambda a: a.design.half_range, (3.0, 3.0)),
}  # fmt: skip
"""Settings that fix levels, agents and the number of updates."""
IN_LEARNING = {
    *("actor_learning_rate", "critic_learning_rate", "discount", "batch_size", "target_rate", "policy_delay"),
    "noise_unit",
}
IN_COLLECTOR = {"reward_scale", "bootstrap_terminal", "num_envs"}


@pytest.mark.parametrize("name", SEEN)
def test_a_setting_arrives_where_it_is_used(name):
    value, read, expected = SEEN[name]
    assert read(build(**{name: value})) == expected != read(build())


def test_every_setting_has_a_test():
    """Those of learning and experience are varied in test_learning.py and test_collector.py."""
    settings = {name for section in HIRO_SECTIONS.values() for name in setting_fields(section)}
    assert settings == SEEN.keys() | IN_LEARNING | IN_COLLECTOR


REFUSED = {
    # (algorithm, environment, settings): message
    ("td3", "gymnasium:CartPole-v1"): ({}, r"the actions of gymnasium:CartPole-v1 are discrete.*--algorithm es"),
    ("hiro", "point-flagrun"): ({}, "point-flagrun sets the goals, so .*Set --algorithm to shes, .*es or td3"),
    ("td3", "point-maze"): ({"hidden": ()}, r"hidden must be at least one layer.*Set --hidden\."),
    ("hiro", "ant-push"): ({"max_tilt": 60.0}, r"max_tilt ends episodes of ant-push that .*Omit --max-tilt"),
    ("td3", "point-push"): ({"batch_size": 101}, r"batch_size is 101, more than the 100 transitions of replay_size"),
    ("hiro", "point-maze"): ({"controller_interval": 21}, "controller_interval is 21, but episodes have 20 steps"),
    ("hiro", "point-push"): ({"num_envs": 61}, "num_envs is 61, but a generation has 60 environment steps"),
    ("td3", "point-fall"): ({"device": "warp-cpu"}, "device is 'warp-cpu', but td3 collects its experience on the CPU"),
    ("hiro", "point-gather"): ({"replay_size": 10**12}, r"replay_size is 1,000,000,000,000: .* Set --replay-size, "),
}


@pytest.mark.parametrize(("name", "env"), REFUSED)
def test_what_cannot_be_served_is_refused(name, env):
    settings, message = REFUSED[name, env]
    with pytest.raises(ConfigError, match=message):
        build(name, env, **settings).start(0)


@over_algorithms
def test_without_jax_the_error_names_the_extra(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, LEARNING, raising=False)
    message = rf"--algorithm {name} needs JAX and Optax .* pip install 'shes\[hiro\]'"
    with pytest.raises(MissingExtraError, match=message):
        train(tmp_path / "run", name)
    assert list(tmp_path.iterdir()) == []


def test_a_level_of_hiro_is_not_transferred(untrained):
    path = untrained("hiro", "point-maze")
    with pytest.raises(ConfigError, match=r"the primitive of .* was trained by hiro; only levels that shes trained"):
        make_config("point-maze", "smoke", {"primitive": str(path)})


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"policy/actor": np.zeros(3, np.float32)}, r"policy/actor is float32 of shape \(3,\)"),
        ({"policy/observation_count": np.array(1.5)}, r"policy/observation_count is float64"),
        ({"policy/replay/older/reward": np.zeros((2, 2), np.float32)}, "of a replay buffer is float32 of shape"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(untrained, change, fault):
    path = untrained("td3", "point-maze")
    file = path / "checkpoints" / "last.npz"
    np.savez(file, **{**np.load(file), **change})
    with pytest.raises(CheckpointError, match=rf"last\.npz (.|\n)*{fault}"):
        open_run(path, "last")


# Agents.

KINDS = {
    "hiro": ("hiro", "point-gather", {"controller_interval": 7}),
    "ant": ("hiro", "ant-maze", {"spec": "hiro"}),
    "td3": ("td3", "ant-maze", {"normalise_inputs": False}),
}
over_kinds = pytest.mark.parametrize("kind", KINDS)


@over_kinds
def test_an_agent_acts_and_is_exported_without_jax(untrained, tmp_path, monkeypatch, kind):
    name, env, settings = KINDS[kind]
    for module in ("jax", "optax"):
        monkeypatch.setitem(sys.modules, module, None)
    path = untrained(name, env, **settings)
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported, actions = run_exported.ExportedAgent(file), []
    for observation, action, _ in episode(path):
        np.testing.assert_array_equal(exported.act(observation), action)
        actions.append(action)
    assert len(np.unique(actions, axis=0)) > 30
    assert shes.evaluate(path, episodes=2, num_workers=1).summary()["episodes"] == 2
    assert main(["info", str(path)]) == 0


@pytest.mark.extras
@over_kinds
def test_onnx_graphs_act_as_the_agent_to_float32_rounding(untrained, tmp_path, kind):
    pytest.importorskip("onnx")
    name, env, settings = KINDS[kind]
    path = untrained(name, env, **settings)
    exported = OnnxAgent(shes.export(path, tmp_path / "policy.onnx", format="onnx"))
    for observation, action, _ in episode(path):
        np.testing.assert_allclose(exported.act(observation), action, atol=2e-5)


def test_a_constant_controller_changes_x_and_y_alone(untrained):
    outputs = build(env="ant-maze").design.direction_outputs(np.array([0.0, np.pi / 6]))
    assert outputs.shape == (2, 15)
    np.testing.assert_allclose(outputs[:, :2], [[1, 0], [np.sqrt(0.75), 0.5]])
    assert not outputs[:, 2:].any()
    path = untrained("hiro", "point-gather")
    assert shes.evaluate(path, episodes=2, controller="constant").controller.startswith("constant: ")


@pytest.mark.parametrize("env", ["point-push", "ant-gather"])
def test_an_agent_acts_as_in_training_without_noise(untrained, env):
    """The agent holds a goal as a place, the collector moves it by the goal transition: one policy."""
    noise = {"exploration_noise": 0.0, "goal_noise": 0.0}
    path = untrained("hiro", env, controller_interval=3, normalise_inputs=False, **noise)
    learner, agent = build_algorithm(RunFolder(path).read_config()), shes.load(path)
    state = learner.from_arrays(RunFolder(path).load("last").arrays)
    actors = [Actor(level) for level in learner.levels]
    for actor, own in zip(actors, state.learners, strict=True):
        actor.use(own.learner["actor"], own.statistics)
    batch = learner.problem.env.make(1, learner.problem.training)
    collector = learner.collector(batch, learner.design, actors, learner.problem.horizon, learner.settings)
    blocks = collector.run(1, itertools.count(7), np.random.default_rng(0))
    played = [block["primitive"]["action"][0] for block in blocks]
    task, one = learner.problem.env.make(1, learner.problem.training), np.array([0])
    task.reset(one, [7])
    for expected in played:
        action = agent.act(task.observe()[0]).astype(float) * task.control_limit
        np.testing.assert_allclose(action, expected, atol=1e-4 * task.control_limit)
        task.step(one, action[None])
    assert len(played) == 20
    assert np.ptp(played, axis=0).min() > 0.01


# Learning.


@needs_jax
@over_algorithms
def test_a_resumed_run_has_the_numbers_of_one_that_never_stopped(tmp_path, name):
    """With a buffer that is full, and wraps around the end of its memory."""
    pytest.importorskip("jax")
    whole = train(tmp_path / "whole", name, generations=6)
    parts = train(tmp_path / "parts", name, generations=1)
    for generations in (3, 4, 6):
        shes.resume(parts, generations=generations)
    assert runs.differences(whole, parts) == []
    assert "last.npz/seed" in runs.differences(whole, train(tmp_path / "other", name, seed=4, generations=6))
    replay = runs.state(whole).learners[-1].replay
    assert (replay.size, replay.end) == (100, 360)
    assert all(level.mean.any() for level in build(name).parameters(runs.state(whole)))  # inputs are normalised


@needs_jax
def test_the_buffer_is_in_the_last_checkpoint_alone(tmp_path):
    """It is filled anew by a run that goes on from another one."""
    pytest.importorskip("jax")
    path = train(tmp_path / "run")
    sizes = {name: runs.state(path, name).learners[-1].replay.size for name in ("last", "best", "2")}
    assert sizes == {"last": 100, "best": 0, "2": 0}
    shutil.copy(path / "checkpoints" / "generation_000002.npz", path / "checkpoints" / "last.npz")
    before = runs.state(path).learners[-1].learner["num_updates"]
    shes.resume(path, generations=5)
    after = runs.state(path).learners[-1]
    assert after.replay.size == 100
    assert after.learner["num_updates"] > before


SETTINGS_OF_JAX = ["JAX_ENABLE_X64=1", "JAX_NUMPY_RANK_PROMOTION=raise", "JAX_PLATFORMS=nonsense"]


@needs_jax
def test_settings_of_jax_elsewhere_change_nothing(tmp_path):
    """Those of a script that uses JAX for something else; a device that is not there is an error with its fix."""
    pytest.importorskip("jax")
    expected, words = train(tmp_path / "run", generations=3), runs.flags(**TINY, algorithm="hiro", num_workers=1)
    for setting in SETTINGS_OF_JAX:
        name, value = setting.split("=")
        command = [*runs.COMMAND, "train", "point-gather", *words, "--out", str(tmp_path / name)]
        command[command.index("--generations") + 1] = "3"
        environment = {**os.environ, name: value}
        done = subprocess.run(command, check=False, env=environment, capture_output=True, text=True)
        if value == "nonsense":
            assert (done.returncode, "Traceback" in done.stderr) == (2, False)
            assert "Unset JAX_PLATFORMS" in done.stderr
        else:
            assert done.returncode == 0, done.stderr
            assert runs.differences(expected, tmp_path / name) == []


@needs_jax
@pytest.mark.parametrize("num_envs", [1, 4])
def test_each_step_after_the_warm_up_has_its_update(tmp_path, num_envs):
    """Episodes have 20 steps: the warm-up of 130 ends after 140 or 160."""
    pytest.importorskip("jax")
    settings = {"warmup_steps": 130, "generation_steps": 70, "update_interval": 5, "controller_update_interval": 10}
    table = read_csv(train(tmp_path / "run", generations=3, num_envs=num_envs, **settings) / "progress.csv")
    steps = np.array(table["env_steps"])
    assert steps.tolist() == {1: [140, 220, 300], 4: [160, 240, 320]}[num_envs]
    assert table["primitive_updates"] == (steps - steps[0]).tolist()
    assert table["controller_updates"] == ((steps - steps[0]) // 10).tolist()


@needs_jax
def test_networks_that_diverge_end_the_run_before_they_act(tmp_path):
    pytest.importorskip("jax")
    rates = {"critic_learning_rate": 1e30, "actor_learning_rate": 1e30}
    path = train(tmp_path / "run", generations=1, **rates)
    with pytest.raises(DivergenceError, match=r"the networks of the .* have diverged after .*last checkpoint is kept"):
        shes.resume(path, generations=4)
    state, agent = runs.state(path), shes.load(path)  # a state with NaN would be refused
    assert state.generation == 1
    assert np.isfinite(agent.act(np.zeros(agent.observation_size))).all()
    assert main(["resume", str(path), "--generations", "4"]) == 1


@needs_jax
def test_a_run_is_rendered_plotted_and_compared_as_any_other(tmp_path, capsys):
    pytest.importorskip("jax")
    one, other = train(tmp_path / "hiro"), train(tmp_path / "td3", "td3")
    shes.plot([one, other], out=tmp_path / "curves.png")
    shes.render([one, other], out=tmp_path / "both.gif", steps=3, size=64)
    assert min((tmp_path / name).stat().st_size for name in ("curves.png", "both.gif")) > 1000
    *_, shown = Playback(one, "best", steps=3).play(3)
    assert any(marker.color == GOAL for marker in shown.markers)
    assert main(["compare", str(one), str(other), "--episodes", "2", "--workers", "1"]) == 0
    assert "p " in capsys.readouterr().out
    columns, levels = read_csv(one / "progress.csv").keys(), ("controller", "primitive")
    assert {f"{name}_return_mean" for name in levels} | {f"{name}_replay_size" for name in levels} <= columns
    assert {"goal_distance_mean", "primitive_critic_loss", "rollout_s", "update_s", "physics_s"} <= columns
