"""Exported agents act as ours: by NumPy bit-identically, by ONNX to float32 rounding."""

import json
import runpy
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import shes
from shes.cli import main
from shes.envs.gymnasium_ids import gymnasium_id
from tests.e2e import runs

EXAMPLE = Path(__file__).parents[2] / "examples" / "run_exported.py"
run_exported = SimpleNamespace(**runpy.run_path(str(EXAMPLE), run_name="run_exported"))

EGOCENTRIC = {"primitive_view": "egocentric", "goal_encoding": "angle_metres"}
FREE = {"minimum_goal_distance": False}
KINDS = {
    "flat": ("point-gather", {"algorithm": "es", "clock_frequency": 0.8}),
    "primitive": ("point-flagrun", {"controller_interval": 7, "goal_encoding": "unit_vector"}),
    "primitive with symmetry": (
        "ant-flagrun", {**EGOCENTRIC, "symmetry": "dihedral", "clock_frequency": 1.6, "controller_interval": 7},
    ),
    "two levels": ("point-gather", {"minimum_goal_distance": True, "goal_distance": 1.5}),
    "one-hot controller": (
        "point-maze", {"controller_output": "one_hot", "primitive_view": "proprioception", **FREE},
    ),
    "egocentric points": (
        "point-fall",
        {**EGOCENTRIC, **FREE, "controller_view": "egocentric", "goal_encoding": "vector", "primitive_hidden": (),
         "controller_interval": 3, "goal_distance": 1.0},
    ),
    "sectors": (
        "ant-gather",
        {"controller_view": "sectors", "controller_output": "heading_direction", "goal_encoding": "angle",
         "controller_interval": 5},
    ),
    "equivariant": (
        "ant-gather",
        {"controller_network": "equivariant", "controller_view": "sectors", "controller_output": "heading_direction"},
    ),
    "position": ("point-push", {"controller_view": "position", "controller_output": "direction"}),
    "rotations": (
        "ant-push",
        {**EGOCENTRIC, "symmetry": "rotation", "controller_view": "egocentric", "controller_output": "vector"},
    ),
}  # fmt: skip
STEPS = 60


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a function that returns the folder of a tiny run of one of `KINDS`."""
    usual = {"population_size": 4, "horizon": 40, "generations": 1, "evaluation_interval": 1}
    kinds = {kind: (env, {"output_weights": "glorot_normal", **usual, **own}) for kind, (env, own) in KINDS.items()}
    return runs.trained_once(tmp_path_factory.mktemp("exported"), kinds)


def episode(path):
    """Yield the observation, the action and the goal of every step of our agent in an episode of its environment."""
    agent = shes.load(path)
    env = gymnasium.make(gymnasium_id(agent.config.run.env, agent.config.environment.spec), max_episode_steps=STEPS + 1)
    observation, _ = env.reset(seed=3)
    for _ in range(STEPS):
        action = agent.act(observation)
        yield observation, action, None if agent.goal is None else agent.goal[0]
        observation = env.step(action)[0]
    env.close()


@pytest.mark.parametrize("kind", [*KINDS, "ant-gather"])  # the last one is shipped
def test_numpy_alone_acts_as_our_agent_to_the_bit(trained, tmp_path, kind):
    path = trained(kind) if kind in KINDS else kind
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported, steps = run_exported.ExportedAgent(file), list(episode(path))
    for _ in range(2):
        exported.reset()
        for observation, action, goal in steps:
            given = {} if "controller" in exported.spec else {"goal": goal}
            np.testing.assert_array_equal(exported.act(observation, **given), action)
    assert len(np.unique([action for _, action, _ in steps], axis=0)) > STEPS / 2  # the episode proves something


def test_the_command_exports_the_checkpoint_that_is_asked_for(trained, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    weights = []
    for checkpoint, generation in (("0", 0), ("last", 1)):
        assert main(["export", str(trained("two levels")), "--checkpoint", checkpoint]) == 0
        assert capsys.readouterr().out == "Policy: policy.npz\n"
        with np.load("policy.npz", allow_pickle=False) as found:
            weights.append(found["controller/weights_0"])
            spec = json.loads(str(found["description"]))
        assert (spec["env"], spec["levels"]) == ("point-gather", ["controller", "primitive"])
        assert (spec["generation"], weights[-1].shape) == (generation, (len(spec["observation"]), 4))
    assert not np.array_equal(*weights)


@pytest.mark.parametrize(("env_id", "kind"), [("CartPole-v1", "discrete"), ("Pendulum-v1", "box")])
def test_the_actions_of_external_environments_are_described(tmp_path, env_id, kind):
    path = runs.train_tiny(tmp_path / "run", f"gymnasium:{env_id}", algorithm="es", generations=1)
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported, ours = run_exported.ExportedAgent(file), shes.load(path)
    action = exported.spec["action"]
    assert action["kind"] == kind
    for seed in range(5):
        observation, _ = gymnasium.make(env_id).reset(seed=seed)
        control = exported.act(observation)
        if kind == "discrete":
            assert ours.act(observation) == action["start"] + control.argmax()
        else:
            low, high = np.array(action["low"]), np.array(action["high"])
            scaled = (low + high) / 2 + control * ((high - low) / 2)
            np.testing.assert_array_equal(scaled.astype(action["dtype"]), ours.act(observation))


def test_an_external_robot_is_told_its_pose(tmp_path):
    def locate(observation, info):
        return (*observation[:2], 0.5)

    make = partial(gymnasium.make, "shes/PointMaze-v0")
    shes.register_external("exported-point", make, locate=locate)
    path = runs.train_tiny(tmp_path / "run", "exported-point", generations=1, goal_encoding="angle")
    (file,) = shes.export(path, tmp_path / "policy.npz")
    exported, ours, env = run_exported.ExportedAgent(file), shes.load(path), make()
    assert exported.spec["pose"] is None
    observation, info = env.reset(seed=1)
    for _ in range(STEPS):
        action = ours.act(observation, info)
        np.testing.assert_array_equal(exported.act(observation, pose=locate(observation, info)), action)
        observation, _, _, _, info = env.step(action)


class OnnxAgent(run_exported.ExportedAgent):
    """The same agent whose networks are ONNX graphs, run by onnx's reference evaluator."""

    def __init__(self, paths):
        import onnx
        from onnx.reference import ReferenceEvaluator

        models = [onnx.load(path) for path in paths]
        self.graphs = {model.graph.name: ReferenceEvaluator(model) for model in models}
        self.spec = json.loads({each.key: each.value for each in models[0].metadata_props}["description"])
        self.reset()

    def network(self, level, inputs):
        (output,) = self.graphs[level].run(None, {"observation": np.array([inputs, inputs])})  # a batch
        assert output.dtype == np.float32
        np.testing.assert_allclose(*output, atol=1e-6)
        return output[0]


@pytest.mark.extras
@pytest.mark.parametrize("kind", ["flat", "primitive with symmetry", "two levels", "rotations"])
def test_onnx_graphs_act_as_our_agent_to_float32_rounding(trained, tmp_path, kind):
    pytest.importorskip("onnx")
    path = trained(kind)
    files = shes.export(path, tmp_path / "policy.onnx", format="onnx")
    exported = OnnxAgent(files)
    assert len(files) == len(exported.spec["levels"])
    assert {file.name for file in files} <= {"policy.onnx", "policy-controller.onnx", "policy-primitive.onnx"}
    for observation, action, goal in episode(path):
        given = {} if "controller" in exported.spec else {"goal": goal}
        np.testing.assert_allclose(exported.act(observation, **given), action, atol=2e-6)
