"""Multilayer perceptron over flat parameter vectors, for many policies at once.

Source: the SHES authors' code: tanh after every layer, including the output.
In a stacked matmul, the results of a policy are bit-identical whatever other policies are stacked with it, as long as
its number of rows stays the same. Callers therefore never change the row count of a policy.
"""

from __future__ import annotations

from itertools import pairwise
from types import ModuleType
from typing import Annotated, ClassVar, TypeAlias

import numpy as np

from shes.settings import Example, Ge, checked
from shes.types import F32Array, F64Array

BIAS_INITIALISATIONS = ("zero", "glorot_normal")
"""`glorot_normal` as in the authors' code: a bias vector of n has the standard deviation sqrt(2 / (1 + n))."""

OUTPUT_INITIALISATIONS = ("glorot_normal", "zero")
"""`zero` starts with outputs of zero. Random weights would drive the outputs of a linear policy to their limits."""

Layers: TypeAlias = tuple[tuple[F32Array, F32Array], ...]
"""Weights [P, in, out] and biases [P, 1, out] of each layer of P policies."""

Rows: TypeAlias = tuple[tuple[F32Array, F32Array], ...]
"""Scale of the noise and biases of each row, both [P, R, out], at each layer. They are stored for all outputs, because
broadcasting them in NumPy would be several times slower."""

_CACHE_LINE = 64  # bytes


def aligned_rows(rows: int, columns: int) -> F32Array:
    """Return zeros [rows, columns]. Every row starts on a cache line, so that its place does not affect rounding."""
    per_line = _CACHE_LINE // 4
    stride = -(-columns // per_line) * per_line
    raw = np.zeros(rows * stride + per_line, np.float32)
    offset = (-raw.ctypes.data % _CACHE_LINE) // 4
    return raw[offset : offset + rows * stride].reshape(rows, stride)[:, :columns]


class MLP:
    """A network's layer sizes. Its parameters are a flat vector [D]: weights [in, out] and biases, layer by layer."""

    hidden_activation: ClassVar[str] = "tanh"
    """Activation of the hidden layers, for an exported agent. The output layer always has tanh."""
    is_tied: ClassVar[bool] = False
    """Whether weights share parameters, so that `expand` has to be called before `layers`."""

    @checked
    def __init__(
        self, num_inputs: int, hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64")], num_outputs: int
    ) -> None:
        """Create a network with layers of these sizes; raise ConfigError unless the hidden ones are positive."""
        self.sizes = (num_inputs, *hidden, num_outputs)
        self.num_params = self.num_weights = sum((fan_in + 1) * fan_out for fan_in, fan_out in pairwise(self.sizes))

    def initial(
        self, rng: np.random.Generator, bias_initialisation: str = "zero", output_initialisation: str = "glorot_normal"
    ) -> F32Array:
        """Return initial parameters [D]. Weights of hidden layers are Glorot-normal."""
        parts: list[F32Array] = []
        for fan_in, fan_out in pairwise(self.sizes):
            weights = rng.standard_normal(fan_in * fan_out) * np.sqrt(2 / (fan_in + fan_out))
            biases = rng.standard_normal(fan_out) * np.sqrt(2 / (1 + fan_out))
            parts += [weights.astype(np.float32), (biases * (bias_initialisation != "zero")).astype(np.float32)]
        if output_initialisation == "zero":
            parts[-2:] = [np.zeros_like(part) for part in parts[-2:]]
        return np.concatenate(parts)

    def expand(self, theta: F32Array, xp: ModuleType = np) -> F32Array:
        """Return the weights and biases [P, W] of policies `theta` [P, D]: here the parameters themselves."""
        return theta

    def pool(self, total: F64Array, total_squares: F64Array) -> None:
        """Make sums over observations [O] as symmetric as the network, in place: here they remain as they are."""

    def layers(self, weights: F32Array) -> Layers:
        """Return the layers of policies with `weights` [P, W], as `expand` returns them, as views."""
        policies, start = weights.shape[0], 0
        found: list[tuple[F32Array, F32Array]] = []
        for fan_in, fan_out in pairwise(self.sizes):
            end = start + fan_in * fan_out
            found.append(
                (weights[:, start:end].reshape(policies, fan_in, fan_out), weights[:, None, end : end + fan_out])
            )
            start = end + fan_out
        return tuple(found)

    def act(self, theta: F32Array, observation: F32Array) -> F32Array:
        """Return the outputs [P, R, A] in [-1, 1] of policies `theta` [P, D] on normalised `observation` [P, R, O]."""
        return self.forward(self.layers(self.expand(theta)), observation)

    @staticmethod
    def activate(layer: F32Array) -> None:
        """Apply the activation of the hidden layers to `layer`, in place."""
        np.tanh(layer, out=layer)

    def forward(self, layers: Layers, observation: F32Array) -> F32Array:
        """Return the outputs [P, R, A] of policies with these `layers`; see `act`."""
        layer, last = observation, len(layers) - 1
        for i, (weights, biases) in enumerate(layers):
            layer = layer @ weights
            layer += biases
            if i < last:
                self.activate(layer)
        return np.tanh(layer, out=layer)

    def forward_around(self, mean: Layers, noise: Layers, rows: Rows, observation: F32Array) -> F32Array:
        """Return the outputs [P, R, A] of policies `mean + scale * noise` on normalised `observation` [P, R, O].

        The R rows of a lane share a noise vector, which is read once for all of them: `x (W + s N) = x W + s (x N)`.
        With few rows, a matmul with separate weights for each policy would be limited by memory bandwidth.

        Args:
            mean: Layers of one policy, P = 1.
            noise: Layers of the P noise vectors.
            rows: Scale and biases of each row.
            observation: Normalised observation of each row.
        """
        layer, last = observation, len(mean) - 1
        for i, ((weights, _), (noise_weights, _), (scale, biases)) in enumerate(zip(mean, noise, rows, strict=True)):
            perturbed = layer @ noise_weights
            perturbed *= scale
            perturbed += layer @ weights
            perturbed += biases
            layer = perturbed
            if i < last:
                self.activate(layer)
        return np.tanh(layer, out=layer)


class RectifiedMLP(MLP):
    """A network with rectified linear units (ReLU) in its hidden layers. Source: Fujimoto et al. 2018 (TD3)."""

    hidden_activation = "relu"

    @staticmethod
    def activate(layer: F32Array) -> None:
        """Replace negative values of `layer` by 0, in place."""
        np.maximum(layer, 0, out=layer)
