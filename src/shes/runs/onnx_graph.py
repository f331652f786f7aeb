"""A policy as an ONNX graph: normalisation, then the network. Source: the ONNX operator set 17."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.errors import MissingExtraError
from shes.es.level import LevelParameters
from shes.policies.mlp import MLP

_OPERATORS, _IR_VERSION = 17, 8  # onnxruntime 1.13 (2022) or newer


def onnx_model(name: str, policy: MLP, level: LevelParameters, clip: float | None, notes: Mapping[str, str]) -> bytes:
    """Return the serialised model of one level, with `notes` as its metadata. Normalised inputs are clipped to `clip`.

    Input `observation` [N, O] float64, the level's inputs before normalisation; output `output` [N, A] float32 in
    [-1, 1].
    """
    onnx = _load_onnx()
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
    graph = helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info("observation", kinds.DOUBLE, ["N", policy.sizes[0]])],
        [helper.make_tensor_value_info("output", kinds.FLOAT, ["N", policy.sizes[-1]])],
        [onnx.numpy_helper.from_array(np.ascontiguousarray(array), key) for key, array in constants.items()],
    )
    model = helper.make_model(
        graph,
        producer_name="shes",
        ir_version=_IR_VERSION,
        opset_imports=[helper.make_opsetid("", _OPERATORS)],
    )
    helper.set_model_props(model, dict(notes))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _load_onnx() -> Any:
    """Return the package `onnx`; raise MissingExtraError if it is not installed."""
    try:
        return importlib.import_module("onnx")
    except ImportError as error:
        raise MissingExtraError(
            f"the format onnx needs the package onnx ({error}). Install it: pip install 'shes[onnx]', or use --format "
            "npz."
        ) from error
