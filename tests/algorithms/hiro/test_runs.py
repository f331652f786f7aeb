"""Runs of HIRO and TD3: equal numbers, checkpoints, errors, and agents that act without JAX."""

import itertools
import shutil
import signal
import sys
import tracemalloc
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import shes
from shes.algorithms.hiro import algorithm as hiro
from shes.algorithms.hiro import designs
from shes.algorithms.hiro.agent import HiroAgent
from shes.algorithms.hiro.collector import Actor
from shes.cli import main
from shes.envs.markers import GOAL
from shes.errors import CheckpointError, ConfigError, DivergenceError, MissingExtraError
from shes.runs.build import build_algorithm, open_run
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.training.make_config import make_config
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


def settings_of(name, **settings):
    return {**TINY, "algorithm": name, **settings}


def train(path, name="hiro", env="point-gather", **settings):
    return shes.train(env, out=path, **settings_of(name, **settings)).path


@pytest.fixture
def untrained(tmp_path, monkeypatch):
    """Return a function that makes the folder of a run of 0 generations, without JAX."""
    monkeypatch.setattr(hiro, "import_learning", lambda _: None)

    def make(name, env, **settings):
        values = settings_of(name, **settings)
        config = make_config(env, values.pop("preset"), values)
        learner, folder = build_algorithm(config), RunFolder.create(tmp_path / f"{name}-{env}")
        arrays = learner.to_arrays(learner.start(config.run.seed))
        for level in learner.level_names:  # an initial actor does next to nothing
            arrays[f"{level}/actor"] = np.random.default_rng(1).normal(0, 0.3, arrays[f"{level}/actor"].shape)
            arrays[f"{level}/actor"] = arrays[f"{level}/actor"].astype(np.float32)
        with folder.lock():
            for checkpoint in ("best", "last"):
                state = Checkpoint(arrays=arrays, best=Best(), numbers=config.numbers())
                save_checkpoint(folder.checkpoint_path(checkpoint), state)
            folder.record_start(config, {})
        return folder.path

    return make


KINDS = {
    "hiro": ("hiro", "point-gather", {"controller_interval": 7}),
    "ant": ("hiro", "ant-maze", {"spec": "hiro"}),
    "td3": ("td3", "ant-maze", {"normalise_inputs": False}),
}


@pytest.mark.parametrize("kind", KINDS)
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


@pytest.mark.parametrize("kind", ["hiro", "ant"])
def test_a_controller_that_has_learned_nothing_changes_x_and_y_alone(untrained, monkeypatch, kind):
    def decide(agent, due, observation, noise):
        goals.append(original(agent, due, observation, noise))
        return goals[-1]

    name, env, settings = KINDS[kind]
    path, original, goals = untrained(name, env, **settings), HiroAgent._decide, []
    monkeypatch.setattr(HiroAgent, "_decide", decide)
    assert shes.evaluate(path, episodes=2, controller="constant").controller.startswith("constant: ")
    distance = open_run(str(path), "best").algorithm.design.goals.half_range[0]
    zero, *constant = np.split(np.array(goals), 9)
    for number, found in enumerate(constant):
        angle = number * np.pi / 4
        expected = distance * np.array([np.cos(angle), np.sin(angle)])
        assert found[..., :2] == pytest.approx(np.broadcast_to(expected, found[..., :2].shape), abs=1e-6)
    assert not zero.any()
    assert not np.array(goals)[..., 2:].any()
    goals.clear()
    shes.evaluate(path, episodes=2, controller="random")
    found = np.reshape([each[0, :2] for each in goals], (-1, 2))
    assert np.hypot(*found.T) == pytest.approx(np.full(len(found), distance))
    assert len(np.unique(found, axis=0)) == len(goals) > 1


@pytest.mark.extras
@pytest.mark.parametrize("kind", KINDS)
def test_onnx_graphs_act_as_the_agent_to_float32_rounding(untrained, tmp_path, kind):
    pytest.importorskip("onnx")
    name, env, settings = KINDS[kind]
    path = untrained(name, env, **settings)
    exported = OnnxAgent(shes.export(path, tmp_path / "policy.onnx", format="onnx"))
    for observation, action, _ in episode(path):
        np.testing.assert_allclose(exported.act(observation), action, atol=2e-5)


def test_the_goal_of_an_agent_is_held_at_a_place(untrained):
    path = untrained("hiro", "point-maze", controller_interval=3)
    agent, env = shes.load(path), gymnasium.make("shes/PointMaze-v0")
    observation, _ = env.reset(seed=1)
    goals = []
    for _ in range(6):
        observation = env.step(agent.act(observation))[0]
        goals.append(agent.goal[0].tolist())
    assert goals[0] == goals[1] == goals[2] != goals[3] == goals[5]
    env.close()


@pytest.mark.parametrize("env", ["point-push", "ant-gather"])
def test_an_agent_acts_as_in_training_without_noise(untrained, env):
    """The agent holds a goal as a place, the collector moves it by the goal transition: one policy."""
    noise = {"exploration_noise": 0.0, "goal_noise": 0.0}
    path = untrained("hiro", env, controller_interval=3, normalise_inputs=False, **noise)
    learner, agent = build_algorithm(RunFolder(path).read_config()), shes.load(path)
    state = learner.from_arrays(RunFolder(path).load("last").arrays)
    actors = {level.name: Actor(level, learner.design.input_clip) for level in learner.levels}
    for actor, own in zip(actors.values(), state.learners, strict=True):
        actor.use(own.parameters)
    batch = learner.problem.env.make(1, learner.problem.training)
    played = []
    for block in learner.make_collector(batch, actors).run(1, itertools.count(7), np.random.default_rng(0)):
        played.append(block["primitive"]["action"][0])
    task, one = learner.problem.env.make(1, learner.problem.training), np.array([0])
    task.reset(one, [7])
    for expected in played:
        action = agent.act(task.observe()[0]).astype(float) * task.control_limit
        np.testing.assert_allclose(action, expected, atol=1e-4 * task.control_limit)
        task.step(one, action[None])
    assert len(played) == 20
    assert np.ptp(played, axis=0).min() > 0.01


@pytest.mark.parametrize("name", ["hiro", "td3"])
def test_without_jax_the_error_names_the_extra_and_no_folder_is_made(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "shes.algorithms.hiro.level_learner", raising=False)
    message = rf"--algorithm {name} needs JAX and Optax .* pip install 'shes\[hiro\]'"
    with pytest.raises(MissingExtraError, match=message):
        train(tmp_path / "run", name)
    assert list(tmp_path.iterdir()) == []


def test_a_level_of_hiro_is_not_transferred(untrained):
    path = untrained("hiro", "point-maze")
    with pytest.raises(ConfigError, match=r"the primitive of .* was trained by hiro; only levels that shes trained"):
        make_config("point-maze", "smoke", {"primitive": str(path)})


@pytest.mark.parametrize(
    ("name", "env", "settings", "message"),
    [
        ("td3", "gymnasium:CartPole-v1", {}, r"the actions of gymnasium:CartPole-v1 are discrete.*--algorithm es"),
        ("hiro", "gymnasium:Pendulum-v1", {}, "the position of the robot of gymnasium:Pendulum-v1 is unknown"),
        ("hiro", "point-flagrun", {}, "point-flagrun sets the goals, so .*Set --algorithm to shes, .*es or td3"),
        ("td3", "point-maze", {"hidden": ()}, r"hidden must be at least one layer.*Set --hidden\."),
        ("hiro", "point-maze", {"replay_size": 10**12}, r"replay_size is 1,000,000,000,000.*Set --replay-size \d+ or"),
        (
            "td3",
            "point-maze",
            {"generation_steps": 10**14},
            r"GB are free\. Set --generation-steps, --warmup-steps or --num-envs lower",
        ),
        ("td3", "point-maze", {"sigma": 0.1}, "sigma is not a setting of a run of point-maze with algorithm 'td3'"),
        ("hiro", "ant-push", {"max_tilt": 60.0}, r"max_tilt ends episodes of ant-push that .*Omit --max-tilt"),
        ("hiro", "point-maze", {"discount": 1.0}, r"discount must be .*less than 1"),
        ("td3", "point-maze", {"batch_size": 101}, r"batch_size is 101, more than the 100 transitions of replay_size"),
        ("hiro", "point-maze", {"controller_interval": 21}, r"controller_interval is 21, but episodes have 20 steps"),
    ],
)
def test_what_cannot_be_served_is_refused_before_there_is_a_folder(tmp_path, monkeypatch, name, env, settings, message):
    monkeypatch.setattr(hiro, "import_learning", lambda _: None)
    with pytest.raises(ConfigError, match=message):
        train(tmp_path / "run", name, env, **settings)
    assert list(tmp_path.iterdir()) == []


def test_a_device_is_refused(monkeypatch):
    config = make_config("point-maze", "smoke", {"algorithm": "td3", "device": "warp-cpu"})
    with pytest.raises(ConfigError, match=r"device is 'warp-cpu', but td3 collects its experience on the CPU"):
        build_algorithm(config)


def test_a_checkpoint_of_other_networks_is_refused(untrained):
    path = untrained("td3", "point-maze")
    file = path / "checkpoints" / "last.npz"
    arrays = dict(np.load(file))
    for change, fault in (
        ({"policy/actor": np.zeros(3, np.float32)}, r"policy/actor is float32 of shape \(3,\)"),
        ({"policy/replay/older/reward": np.zeros((2, 2), np.float32)}, "older/reward is float32"),
    ):
        np.savez(file, **{**arrays, **change})
        with pytest.raises(CheckpointError, match=rf"last\.npz is not of this run: {fault}"):
            open_run(path, "last")


# Learning.


@needs_jax
@pytest.mark.parametrize("name", ["hiro", "td3"])
def test_the_same_seed_makes_the_same_run_and_another_one_another(tmp_path, name):
    pytest.importorskip("jax")
    one, other, third = (train(tmp_path / f"{i}", name, seed=seed, num_envs=2) for i, seed in enumerate((3, 3, 4)))
    assert runs.differences(one, other) == []
    assert "last.npz/seed" in runs.differences(one, third)
    assert runs.state(one).learners[-1].num_updates > 0


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
    replay = runs.state(whole).learners[-1].replay
    assert (replay.size, replay.end) == (100, 360)


@needs_jax
def test_a_run_that_was_killed_goes_on_with_equal_numbers(tmp_path):
    pytest.importorskip("jax")
    whole = train(tmp_path / "whole", generations=12)
    words = runs.flags(**{**TINY, "algorithm": "hiro", "generations": 12})
    path = tmp_path / "killed"
    process = runs.start("train", "point-gather", *words, "--out", path)
    runs.stop_inside_generation(process, path, 3)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert shes.resume(path).generation == 12
    assert runs.differences(whole, path) == []


@needs_jax
def test_the_buffer_is_in_the_last_checkpoint_alone_and_is_filled_anew_from_another(tmp_path):
    pytest.importorskip("jax")
    path = train(tmp_path / "run")
    sizes = {name: runs.state(path, name).learners[-1].replay.size for name in ("last", "best", "2")}
    assert sizes == {"last": 100, "best": 0, "2": 0}
    shutil.copy(path / "checkpoints" / "generation_000002.npz", path / "checkpoints" / "last.npz")
    before = runs.state(path).learners[-1].num_updates
    shes.resume(path, generations=5)
    after = runs.state(path).learners[-1]
    assert after.replay.size == 100
    assert after.num_updates > before


@needs_jax
def test_nothing_is_learned_in_the_steps_of_the_warm_up(tmp_path):
    pytest.importorskip("jax")
    path = train(tmp_path / "run", warmup_steps=130, generation_steps=70, generations=3, controller_update_interval=10)
    table = read_csv(path / "progress.csv")
    assert table["env_steps"] == [140, 220, 300]  # whole episodes of 20 steps
    for level, updates in (("primitive", [0, 80, 160]), ("controller", [0, 8, 16])):
        assert table[f"{level}_updates"] == updates


@needs_jax
def test_each_environment_step_has_its_update_however_many_environments_there_are(tmp_path):
    pytest.importorskip("jax")
    for num_envs in (1, 4):
        path = train(tmp_path / f"{num_envs}", num_envs=num_envs, update_interval=5, controller_update_interval=10)
        state = runs.state(path)
        first = int(read_csv(path / "progress.csv")["env_steps"][0])
        assert state.learners[1].num_updates == 5 * (state.env_steps // 5 - first // 5)
        assert state.learners[0].num_updates == state.env_steps // 10 - first // 10


@needs_jax
@pytest.mark.parametrize("loss", ["mse", "huber"])
def test_networks_that_diverge_end_the_run_before_they_act_and_leave_the_last_good_checkpoint(
    loss, tmp_path, monkeypatch
):
    pytest.importorskip("jax")
    use = Actor.use

    def checked(actor, parameters):
        assert np.isfinite(parameters.theta).all()
        use(actor, parameters)

    monkeypatch.setattr(Actor, "use", checked)
    rates = {"critic_learning_rate": 1e30, "actor_learning_rate": 1e30}
    path = train(tmp_path / "run", generations=1, critic_loss=loss, **rates)
    with pytest.raises(DivergenceError, match=r"the networks of the .* have diverged after .*last checkpoint is kept"):
        shes.resume(path, generations=4)
    state = runs.state(path)
    assert state.generation == 1
    assert all(np.isfinite(array).all() for array in state.learners[0].learner.values())
    assert np.isfinite(shes.load(path).act(np.zeros(shes.load(path).observation_size))).all()
    assert main(["resume", str(path), "--generations", "4"]) == 1


def filled(path):
    """Fill the primitive's replay buffer in the checkpoint `last`; return its bytes, and the peak of writing them."""
    folder = RunFolder(path)
    learner, last = build_algorithm(folder.read_config()), folder.load("last")
    controller, primitive = learner.from_arrays(last.arrays).learners
    shapes, size = primitive.replay.shapes, primitive.replay.capacity
    rows = {name: np.zeros((size, *shape), np.float32) for name, shape in shapes.items()}
    full = replace(primitive, replay=primitive.replay.append(rows))
    state = replace(learner.from_arrays(last.arrays), learners=(controller, full))
    with folder.lock():
        tracemalloc.start()
        save_checkpoint(folder.checkpoint_path("last"), replace(last, arrays=learner.to_arrays(state)))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return sum(array.nbytes for array in rows.values()), peak


def test_a_replay_buffer_is_written_without_a_copy(untrained):
    size, peak = filled(untrained("hiro", "ant-maze", replay_size=100_000))
    assert size > 20e6
    assert peak < size / 2


def test_replay_buffers_that_do_not_fit_the_memory_twice_are_not_read(untrained, monkeypatch):
    path = untrained("hiro", "point-gather", replay_size=1000)
    size, _ = filled(path)
    monkeypatch.setattr(designs, "free_memory", lambda: 2 * size + 1000)
    shes.evaluate(path, checkpoint="last", episodes=1, num_workers=1)
    monkeypatch.setattr(designs, "free_memory", lambda: 2 * size - 1)
    message = r"last\.npz has replay buffers that take .* while they are restored, .* choose --checkpoint best"
    with pytest.raises(CheckpointError, match=message):
        shes.resume(path, generations=1)
    shes.evaluate(path, checkpoint="best", episodes=1, num_workers=1)


@needs_jax
def test_a_run_is_rendered_plotted_and_compared_as_any_other(tmp_path, capsys):
    pytest.importorskip("jax")
    one, other = train(tmp_path / "hiro"), train(tmp_path / "td3", "td3")
    shes.plot([one, other], out=tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 1000
    shes.render([one, other], out=tmp_path / "both.gif", steps=3, size=64)
    assert (tmp_path / "both.gif").stat().st_size > 1000
    *_, shown = Playback(one, "best", steps=3).play(3)
    assert any(marker.color == GOAL for marker in shown.markers)
    assert main(["compare", str(one), str(other), "--episodes", "2", "--workers", "1"]) == 0
    assert "p " in capsys.readouterr().out
    columns = read_csv(one / "progress.csv").keys()
    levels = ("controller", "primitive")
    assert {f"{name}_return_mean" for name in levels} | {f"{name}_replay_size" for name in levels} <= columns
    assert {"goal_distance_mean", "primitive_critic_loss", "rollout_s", "update_s", "physics_s"} <= columns
