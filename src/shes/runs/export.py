"""Export of a trained agent for use without this package.

`npz` holds the networks as arrays, `onnx` as a graph for each level. Both hold the rest of the agent, which turns
observations into inputs and outputs into actions, as a description in JSON. `docs/how-to/export.md` documents the
files, and `examples/run_exported.py` acts by NumPy alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shes.agents.goal_agent import MIN_COMPONENT_M, GoalDesign
from shes.agents.mlp import MLP
from shes.envs.bodies.body import Body, SymmetryGroup, dihedral_group, yaw
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError, import_extra
from shes.es.level import LevelParameters
from shes.runs.build import OpenedRun, open_run
from shes.settings import checked
from shes.storage import write_atomically
from shes.types import F64Array

_FORMAT = 1  # of the description
_OPERATORS, _IR_VERSION = 17, 8  # of ONNX: onnxruntime 1.13 (2022) or newer
Networks = Mapping[str, tuple[MLP, LevelParameters]]
"""The network of each level by name, with its parameters and its normalisation."""


@checked
def export(
    run: Path | str,
    out: Path | str | None = None,
    *,
    format: Literal["npz", "onnx"] = "npz",  # noqa: A002 - as the flag
    checkpoint: str = "best",
) -> tuple[Path, ...]:
    """Write the mean policies of a run, with their normalisation, to files that need no SHES.

    The program examples/run_exported.py acts from an npz file with NumPy alone.

    shes export ant-gather --format onnx --out gather.onnx

    Args:
        run: The run folder, or the name of a shipped agent.
        out: The file; an existing one is replaced. `policy.npz` or `policy.onnx` if None.
        format: `npz`, or `onnx` (extra `onnx`). The latter writes `policy-controller.onnx` and `policy-primitive.onnx`
            for an agent with two levels.
        checkpoint: Checkpoint: `best`, `last` or the number of a generation.

    Returns:
        Paths of the files.
    """
    path = Path(f"policy.{format}" if out is None else out)
    if path.suffix != f".{format}":
        raise ConfigError(f"a file of format {format} ends with .{format}, got {str(path)!r}. Set --out or --format.")
    folder = path.resolve().parent
    if folder.name == "checkpoints" and (folder.parent / "config.json").exists():
        raise ConfigError(f"{path} would be among the checkpoints of a run, as which it cannot be read. Set --out.")
    opened = open_run(run, checkpoint)
    parameters = opened.algorithm.parameters(opened.state)
    levels = zip(opened.algorithm.design.networks.items(), parameters, strict=True)
    return FORMATS[format](path, describe(opened), {name: (policy, own) for (name, policy), own in levels})


def describe(run: OpenedRun) -> dict[str, Any]:
    """Return all of an agent but its networks, as JSON types."""
    design, settings = run.algorithm.design, run.config.values
    task, clock = run.algorithm.problem.sample(), design.clock
    control_map = None if task.robot is None else task.robot.control_map
    found: dict[str, Any] = {
        "format": _FORMAT,
        "shes": version("shes"),
        "env": run.config.run.env,
        "generation": run.state.generation,
        "levels": list(design.networks),
        "num_layers": {name: len(network.sizes) - 1 for name, network in design.networks.items()},
        "observation": list(task.observation_names),
        "action": _action(task),
        "hidden_activation": design.policies[-1].hidden_activation,
        "input_clip": design.input_clip if np.isfinite(design.input_clip) else None,
        "control_limit": design.control_limit,
        "scale": task.scale,
        # Offset and factor of each control of the robot's file, for actions in [-1, 1].
        "control_map": None if control_map is None else [each.tolist() for each in control_map],
        "step_s": task.step_s,
        "clock": [] if clock is None else [{"frequency_hz": clock.frequency_hz, "step_s": clock.step_s}],
        **design.exported(),
    }
    if isinstance(design, GoalDesign):
        # Without a symmetry there is the robot's own frame alone, so that a reader needs no case of its own.
        sizes = design.primitive_view.size(task.observation_size), task.action_size
        own = np.eye(sizes[0]), np.eye(sizes[1])
        found["controller_interval"] = design.controller_interval
        found["pose"] = None if task.robot is None else _pose(task.robot, task.proprioception.tolist())
        found["primitive"] = {
            "view": design.primitive_view.to_dict(),
            "goal_encoding": settings["goal_encoding"],
            **_frames(design.symmetry or dihedral_group(1, own, None)),
        }
    if isinstance(design, GoalDesign) and design.controller_view is not None:
        network = design.networks["controller"]
        found["controller"] = {
            "view": design.controller_view.to_dict(),
            "output": settings["controller_output"],
            "num_sectors": network.sizes[-1] if network.is_tied else 0,
            "goal_distance_m": design.goal_distance,
            "min_component_m": float(MIN_COMPONENT_M) if design.has_minimum_goal_distance else 0.0,
        }
    return found


def _action(task: EpisodeBatch) -> dict[str, Any]:
    """Return the bounds of the actions of `task`, or the number of the first discrete action."""
    read, limits = task.reader.to_action, np.full((1, task.action_size), task.control_limit)
    high = read(limits)[0]
    if np.issubdtype(high.dtype, np.integer) and high.ndim == 0:  # the first of equal controls
        return {"kind": "discrete", "start": int(high)}
    return {"kind": "box", "low": read(-limits)[0].tolist(), "high": high.tolist(), "dtype": str(high.dtype)}


def _pose(robot: Body, columns: list[int]) -> dict[str, Any] | None:
    """Return the indices in the observation of position and quaternion, None for a heading that is always 0.

    The result is None for a body whose position is not its first two coordinates or whose heading is not that of its
    quaternion; a reader is then given both.
    """
    turned = robot.quaternion
    qpos = np.random.default_rng(0).standard_normal((8, robot.num_qpos))
    heading: F64Array = np.zeros(8) if turned is None else yaw(qpos[:, turned])
    is_plain = np.allclose(robot.position(qpos) * robot.scale, qpos[:, :2]) and np.array_equal(
        robot.heading(qpos), heading
    )
    quaternion = None if turned is None else columns[turned]
    return {"position": columns[:2], "quaternion": quaternion} if is_plain else None


def _frames(group: SymmetryGroup) -> dict[str, Any]:
    tables = dict(zip(("cosine", "sine", "mirror"), group.direction(), strict=True))
    tables |= {name: getattr(group, name) for name in ("view_index", "view_sign", "control_index", "control_sign")}
    if group.view_matrix is not None:
        tables["view_matrix"] = group.view_matrix
    if group.shifts_clock:
        tables["clock_sign"] = tables["mirror"]
    frames = [{name: table[i].tolist() for name, table in tables.items()} for i in range(len(group.view_index))]
    return {"num_turns": group.num_turns, "is_mirrored": group.is_mirrored, "frames": frames}


def _write_npz(path: Path, description: Mapping[str, Any], networks: Networks) -> tuple[Path, ...]:
    arrays: dict[str, Any] = {"description": np.array(json.dumps(description))}
    for name, (policy, level) in networks.items():
        arrays |= {f"{name}/mean": level.mean, f"{name}/inverse_std": level.inverse_std}
        if policy.is_tied:  # the layers below are expanded, so that a reader needs no case for them
            arrays[f"{name}/parameters"] = level.theta
        for i, (weights, biases) in enumerate(policy.layers(policy.expand(level.theta[None]))):
            arrays |= {f"{name}/weights_{i}": weights[0], f"{name}/biases_{i}": biases[0, 0]}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))
    return (path,)


def _write_onnx(path: Path, description: Mapping[str, Any], networks: Networks) -> tuple[Path, ...]:
    """Write a file for each network, with its graph and the description. Source: the ONNX operator set 17."""
    fix = "Install it: pip install 'shes[onnx]', or use --format npz."
    onnx = import_extra("onnx", "the format onnx needs the package onnx", fix)
    models = {}
    for name, (policy, level) in networks.items():
        model = onnx.helper.make_model(
            _graph(onnx, name, policy, level, description["input_clip"]),
            producer_name="shes",
            ir_version=_IR_VERSION,
            opset_imports=[onnx.helper.make_opsetid("", _OPERATORS)],
        )
        onnx.helper.set_model_props(model, {"description": json.dumps(description)})
        onnx.checker.check_model(model, full_check=True)
        models[path if len(networks) == 1 else path.with_stem(f"{path.stem}-{name}")] = model.SerializeToString()
    for own, content in models.items():
        write_atomically(own, lambda file, content=content: file.write(content))
    return tuple(models)


def _graph(onnx: Any, name: str, policy: MLP, level: LevelParameters, clip: float | None) -> Any:
    """Return the graph of one level: normalisation, with inputs clipped to `clip`, then the network.

    Input `observation` [N, O] float64, the level's inputs before normalisation; output `output` [N, A] float32 in
    [-1, 1].
    """
    helper, kinds = onnx.helper, onnx.TensorProto
    limit = np.inf if clip is None else clip
    bounds = {"low": np.array(-limit), "high": np.array(limit)}
    constants = {"mean": level.mean, "inverse_std": level.inverse_std, **bounds}
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "inverse_std"], ["scaled"]),
        helper.make_node("Max", ["scaled", "low"], ["above"]),
        helper.make_node("Min", ["above", "high"], ["clipped"]),
        helper.make_node("Cast", ["clipped"], ["layer_0"], to=kinds.FLOAT),
    ]
    layers = policy.layers(policy.expand(level.theta[None]))
    hidden = {"tanh": "Tanh", "relu": "Relu"}[policy.hidden_activation]
    for i, (weights, biases) in enumerate(layers):
        constants |= {f"weights_{i}": weights[0], f"biases_{i}": biases[0, 0]}
        end, activation = ("output", "Tanh") if i == len(layers) - 1 else (f"layer_{i + 1}", hidden)
        nodes += [
            helper.make_node("MatMul", [f"layer_{i}", f"weights_{i}"], [f"product_{i}"]),
            helper.make_node("Add", [f"product_{i}", f"biases_{i}"], [f"sum_{i}"]),
            helper.make_node(activation, [f"sum_{i}"], [end]),
        ]
    return helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info("observation", kinds.DOUBLE, ["N", policy.sizes[0]])],
        [helper.make_tensor_value_info("output", kinds.FLOAT, ["N", policy.sizes[-1]])],
        [onnx.numpy_helper.from_array(np.ascontiguousarray(array), key) for key, array in constants.items()],
    )


FORMATS = {"npz": _write_npz, "onnx": _write_onnx}
"""Function that writes an agent and returns its files, by the name of the format."""
