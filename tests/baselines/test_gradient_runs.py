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
from shes.baselines.td3 import TD3State
from shes.cli import main
from shes.envs.markers import GOAL
from shes.errors import CheckpointError, ConfigError, DivergenceError
from shes.runs.build import build_algorithm, open_run
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from shes.viewing.playback import Playback
from tests.e2e import runs
from tests.messages import raises
from tests.runs.test_export import OnnxAgent, episode, run_exported

UNUSED = ("population_size", "evaluation_horizon", "noise_table_size")
TINY = {
    **{name: value for name, value in runs.TINY.items() if name not in UNUSED},
    "hidden": (6,),
    "warmup_steps": 60,
    "generation_steps": 60,
    "batch_size": 5,
    "replay_size": 100,
}
needs_jax = pytest.mark.hiro


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


SEEN = {
    # setting: (value, what reads it, what that finds)
    "hidden": ((9, 8), lambda a: [level.actor.sizes[1:-1] for level in a.levels], [(9, 8)] * 2),
    "replay_size": (777, lambda a: [level.replay.capacity for level in a.levels], [777, 777]),
    "warmup_steps": (90_000, lambda a: a.levels[0].replay.slack, 90_020),
    "generation_steps": (80_000, lambda a: a.levels[0].replay.slack, 80_020),
    "update_interval": (20, lambda a: list(a.updates_due(50, 60)), [("primitive", 20), ("controller", 1)]),
    "controller_update_interval": (30, lambda a: list(a.updates_due(40, 50)), [("primitive", 10)]),
    "goal_distance": (3.0, lambda a: a.design.half_range, (3.0, 3.0)),
}  # fmt: skip
"""Settings that fix levels and the number of updates."""


@pytest.mark.parametrize("name", SEEN)
def test_a_setting_arrives_where_it_is_used(name):
    value, read, expected = SEEN[name]
    assert read(build(**{name: value})) == expected != read(build())


REFUSED = {
    # (algorithm, environment, settings): message
    ("td3", "gymnasium:CartPole-v1"): ({}, "the actions of gymnasium:CartPole-v1 are discrete ... --algorithm es"),
    ("hiro", "point-flagrun"): ({}, "point-flagrun sets the goals, so ... Set --algorithm to shes, ... es or td3"),
    ("hiro", "gymnasium:Pendulum-v1"): ({}, "the position of the robot of gymnasium:Pendulum-v1 is unknown"),
    ("td3", "point-maze"): ({"hidden": ()}, "hidden must be at least one layer ... Set --hidden."),
    ("hiro", "ant-push"): ({"max_tilt": 60.0}, "max_tilt ends episodes of ant-push that ... Omit --max-tilt"),
    ("td3", "point-push"): ({"batch_size": 101}, "batch_size is 101, more than the 100 transitions of replay_size"),
    ("hiro", "point-maze"): ({"controller_interval": 21}, "controller_interval is 21, but episodes have 20 steps"),
    ("td3", "point-fall"): ({"device": "warp-cpu"}, "device is 'warp-cpu', but td3 collects its experience on the CPU"),
    ("hiro", "point-gather"): ({"replay_size": 10**12}, "replay_size is 1,000,000,000,000: ... Set --replay-size, "),
}


@pytest.mark.parametrize(("name", "env"), REFUSED)
def test_what_cannot_be_served_is_refused(name, env):
    settings, message = REFUSED[name, env]
    with raises(ConfigError, message):
        build(name, env, **settings).start(0)


def test_a_level_of_hiro_is_not_transferred(untrained):
    path = untrained("hiro", "point-maze")
    with raises(ConfigError, "has no primitive that can be transferred: it was trained by hiro, and"):
        make_config("point-maze", "smoke", {"primitive": str(path)})


def test_a_checkpoint_of_another_run_is_refused(untrained):
    path = untrained("td3", "point-maze")
    file = path / "checkpoints" / "last.npz"
    arrays = dict(np.load(file))
    for name in ("actor", "replay/older/inputs"):
        np.savez(file, **{**arrays, f"policy/{name}": np.zeros((2, 2), np.float32)})
        with raises(CheckpointError, f"last.npz holds policy/{name} as float32 of shape (2, 2)"):
            open_run(path, "last")


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


@pytest.mark.parametrize(
    ("name", "env", "settings"),
    [
        ("hiro", "point-push", {"controller_interval": 3}),
        ("hiro", "ant-gather", {"controller_interval": 3}),
        ("td3", "point-gather", {}),
    ],
)
def test_an_agent_acts_as_in_training_without_noise(untrained, name, env, settings):
    """Transitions are those of a plain loop. An agent holds a goal as a place, the collector as what is left of it."""
    noise = {"exploration_noise": 0.0, **({"goal_noise": 0.0} if name == "hiro" else {})}
    path = untrained(name, env, normalise_inputs=False, **noise, **settings)
    learner, agent = build_algorithm(RunFolder(path).read_config()), shes.load(path)
    state = learner.from_arrays(RunFolder(path).load("last").arrays)
    actors = [Actor(level) for level in learner.levels]
    for actor, own in zip(actors, state.learners, strict=True):
        actor.use(own.learner["actor"], own.statistics)
    batch = learner.problem.env.make(1, learner.problem.training)
    collector = learner.collector(batch, learner.design, actors, learner.problem.horizon, learner.settings)
    blocks = collector.run(1, itertools.count(7), np.random.default_rng(0))
    played = [{key: rows[0] for key, rows in block[learner.level_names[-1]].items()} for block in blocks]
    task, one, earned = learner.problem.env.make(1, learner.problem.training), np.array([0]), 0.0
    task.reset(one, [7])
    for step in played:
        seen = task.observe()[0].copy()
        action = agent.act(seen).astype(float) * task.control_limit
        np.testing.assert_allclose(step["action"], action, atol=1e-4 * task.control_limit)
        task.step(one, action[None])
        earned += task.reward[0]
        if name == "td3":
            np.testing.assert_allclose(step["inputs"], seen, rtol=1e-4, atol=1e-5)
            np.testing.assert_allclose(step["next_inputs"], task.observe()[0], rtol=1e-4, atol=1e-5)
            assert step["reward"] == pytest.approx(task.reward[0], rel=1e-4)
        assert step["goes_on"] == 1  # the time limit cuts nothing
    assert collector.episodes[0][f"{learner.level_names[0]}_return"] == pytest.approx(earned, rel=1e-4)
    assert len(played) == 20
    assert np.ptp([step["action"] for step in played], axis=0).min() > 0.01


@needs_jax
@pytest.mark.parametrize("name", ["hiro", "td3"])
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
    # The buffer is in the last checkpoint alone; a run that goes on from another one fills it anew.
    assert [runs.state(whole, name).learners[-1].replay.size for name in ("best", "4")] == [0, 0]
    shutil.copy(whole / "checkpoints" / "generation_000004.npz", whole / "checkpoints" / "last.npz")
    before = runs.state(whole).learners[-1].learner["num_updates"]
    shes.resume(whole, generations=7)
    after = runs.state(whole).learners[-1]
    assert (after.replay.size, after.learner["num_updates"] > before) == (100, True)


@needs_jax
def test_settings_of_jax_elsewhere_change_nothing(tmp_path):
    """A script may use JAX for something else; a device that is not there is an error with its fix."""
    pytest.importorskip("jax")
    settings = {**TINY, "generations": 3, "algorithm": "hiro", "num_workers": 1}
    command = [*runs.COMMAND, "train", "point-gather", *runs.flags(**settings), "--out", str(tmp_path / "other")]

    def done(**environment):
        return subprocess.run(command, check=False, env={**os.environ, **environment}, capture_output=True, text=True)

    refused = done(JAX_PLATFORMS="nonsense")
    assert (refused.returncode, "Traceback" in refused.stderr) == (2, False)
    assert "Unset JAX_PLATFORMS" in refused.stderr
    trained = done(JAX_ENABLE_X64="1", JAX_NUMPY_RANK_PROMOTION="raise")
    assert trained.returncode == 0, trained.stderr
    assert runs.differences(train(tmp_path / "run", generations=3), tmp_path / "other") == []


@needs_jax
def test_each_step_after_the_warm_up_has_its_update(tmp_path):
    """Four episodes of 20 steps at a time: the warm-up of 130 ends after 160."""
    pytest.importorskip("jax")
    settings = {"warmup_steps": 130, "generation_steps": 70, "update_interval": 5, "controller_update_interval": 10}
    table = read_csv(train(tmp_path / "run", generations=3, num_envs=4, **settings) / "progress.csv")
    steps = table["env_steps"]
    assert steps.tolist() == [160, 240, 320]
    assert table["primitive_updates"].tolist() == (steps - steps[0]).tolist()
    assert table["controller_updates"].tolist() == ((steps - steps[0]) // 10).tolist()


@needs_jax
def test_networks_that_diverge_end_the_run_before_they_act(tmp_path):
    pytest.importorskip("jax")
    rates = {"critic_learning_rate": 1e30, "actor_learning_rate": 1e30}
    path = train(tmp_path / "run", generations=1, **rates)
    with raises(DivergenceError, "the networks of the ... have diverged after ... last checkpoint is kept"):
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
