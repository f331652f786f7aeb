"""Multilayer perceptrons over flat parameter vectors, and the policies of a level: many networks at once.

A level has N = P * R rows: P lanes of R episodes. The episodes of a lane share one set of parameters, or belong to
several members that perturb the mean by the same noise.

Source: the SHES authors' code: tanh after every layer, including the output. In a stacked matmul, the results of a
policy do not depend on the other policies, as long as its number of rows stays the same. Callers therefore never change
the row count of a policy.
"""

from __future__ import annotations

from itertools import pairwise
from types import ModuleType
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np

from shes.es.level import LevelParameters
from shes.es.statistics import CLIP, Moments
from shes.settings import Example, Ge, checked
from shes.types import F32Array, F64Array, FloatArray, IntArray

Layers: TypeAlias = tuple[tuple[F32Array, F32Array], ...]
"""Weights [P, in, out] and biases [P, 1, out] of each layer of P policies."""

Rows: TypeAlias = tuple[tuple[F32Array, F32Array], ...]
"""Scale of the noise and biases of each row, both [P, R, out], at each layer. They are stored for all outputs, because
broadcasting them in NumPy would be several times slower."""

_CACHE_LINE = 64  # bytes


def normalise(observation: FloatArray, mean: F64Array, inverse_std: F64Array, clip: float = CLIP) -> F32Array:
    """Return `(observation - mean) * inverse_std` [..., O], clipped to [-clip, clip], as float32."""
    scaled = observation - mean
    scaled *= inverse_std
    np.maximum(scaled, -clip, out=scaled)  # two ufuncs are faster than np.clip
    np.minimum(scaled, clip, out=scaled)
    return scaled.astype(np.float32)


def aligned_rows(rows: int, columns: int) -> F32Array:
    """Return zeros [rows, columns]. Every row starts on a cache line, so that its place does not affect rounding."""
    per_line = _CACHE_LINE // 4
    stride = -(-columns // per_line) * per_line
    raw = np.zeros(rows * stride + per_line, np.float32)
    offset = (-raw.ctypes.data % _CACHE_LINE) // 4
    return raw[offset : offset + rows * stride].reshape(rows, stride)[:, :columns]


class MLP:
    """A network's layer sizes. Its parameters are a flat vector [D]: weights [in, out] and biases, layer by layer."""

    hidden_activation: ClassVar[Literal["tanh", "relu"]] = "tanh"
    """Activation of the hidden layers, `tanh` or `relu`. The output layer always has tanh."""
    is_tied: ClassVar[bool] = False
    """Whether weights share parameters, so that `expand` has to be called before `layers`."""
    _first: slice | IntArray = slice(None)  # the first weight of each parameter

    @checked
    def __init__(
        self, num_inputs: int, hidden: Annotated[tuple[int, ...], Ge(1), Example("64 64")], num_outputs: int
    ) -> None:
        """Create a network with layers of these sizes; raise ConfigError unless the hidden ones are positive."""
        self.sizes = (num_inputs, *hidden, num_outputs)
        self.num_params = self.num_weights = sum((fan_in + 1) * fan_out for fan_in, fan_out in pairwise(self.sizes))

    def initial(
        self, rng: np.random.Generator, biases: str = "zero", output_weights: str = "glorot_normal"
    ) -> F32Array:
        """Return initial parameters [D]. Weights of hidden layers are Glorot-normal.

        `glorot_normal` biases are as in the authors' code: a bias vector of n has the standard deviation
        sqrt(2 / (1 + n)). `zero` output weights are for linear policies, whose outputs random ones drive to the limits.
        """
        parts: list[F32Array] = []
        for fan_in, fan_out in pairwise(self.sizes):
            weights = rng.standard_normal(fan_in * fan_out) * np.sqrt(2 / (fan_in + fan_out))
            bias = rng.standard_normal(fan_out) * np.sqrt(2 / (1 + fan_out))
            parts += [weights.astype(np.float32), (bias * (biases != "zero")).astype(np.float32)]
        if output_weights == "zero":
            parts[-2:] = [np.zeros_like(part) for part in parts[-2:]]
        return np.concatenate(parts)[self._first]

    def expand(self, theta: F32Array, xp: ModuleType = np) -> F32Array:
        """Return the weights and biases [P, W] of policies `theta` [P, D]: here the parameters themselves."""
        return theta

    def pool(self, total: F64Array, total_squares: F64Array) -> None:
        """Make sums over observations [O] as symmetric as the network, in place: here they remain as they are."""

    def layers(self, weights: F32Array) -> Layers:
        """Return the layers of policies with `weights` [P, W], as `expand` returns them, as views."""
        found, start = list[tuple[F32Array, F32Array]](), 0
        for fan_in, fan_out in pairwise(self.sizes):
            end = start + fan_in * fan_out
            own = weights[:, start:end].reshape(len(weights), fan_in, fan_out)
            found.append((own, weights[:, None, end : end + fan_out]))
            start = end + fan_out
        return tuple(found)

    def forward(self, layers: Layers, observation: F32Array, mean: Layers = (), rows: Rows = ()) -> F32Array:
        """Return the outputs [P, R, A] in [-1, 1] of policies on normalised `observation` [P, R, O].

        The R rows of a lane may share noise N, which is read once for all of them: `x (W + s N) = x W + s (x N)`. With
        few rows, a matmul with separate weights for each policy would be limited by memory bandwidth.

        Args:
            layers: Layers of the P policies, or noise vectors.
            observation: Normalised observation of each row.
            mean: Layers of the one policy to which noise is added.
            rows: Scale of the noise, and biases, of each row. Empty if `layers` are those of policies.
        """
        layer, last = observation, len(layers) - 1
        for i, (weights, biases) in enumerate(layers):
            outputs = layer @ weights
            if rows:
                scale, biases = rows[i]  # noqa: PLW2901
                outputs *= scale
                outputs += layer @ mean[i][0]
            outputs += biases
            layer = outputs
            if i < last and self.hidden_activation == "relu":
                np.maximum(layer, 0, out=layer)
            else:
                np.tanh(layer, out=layer)
        return layer


class RectifiedMLP(MLP):
    """A network with rectified linear units (ReLU) in its hidden layers. Source: Fujimoto et al. 2018 (TD3)."""

    hidden_activation = "relu"


class LevelPolicies:
    """The policies of one level in P lanes of R rows, with their normalisation and the moments of what they see.

    Arrays belong to `xp`. With `shares_noise`, the parameters of a row are the mean's plus its `scale` times the lane's
    `theta`. Without, `theta` holds the parameters for all rows of the lane.
    """

    def __init__(
        self,
        network: MLP,
        num_lanes: int,
        rows_per_lane: int,
        xp: ModuleType = np,
        *,
        clip: float,
        limit: float,
        shares_noise: bool,
    ) -> None:
        """Allocate the arrays. Normalised inputs are clipped to [-clip, clip], outputs are multiplied by `limit`."""

        def zeros(size: int) -> F32Array:
            return xp.zeros((num_lanes, rows_per_lane, size), np.float32)

        self._network, self._xp, self._rows_per_lane = network, xp, rows_per_lane
        self._clip, self._limit = clip, np.float32(limit)
        self.theta = self._zero_parameters(num_lanes, network.num_params)
        """Parameters, or noise [P, D]. Write those of a lane before `start`, which expands them."""
        self.scale: F32Array = zeros(1)
        """Factor of the lane's noise in the parameters of each row [P, R, 1]."""
        self._weights = self._zero_parameters(num_lanes, network.num_weights) if network.is_tied else self.theta
        self._layers = network.layers(self._weights)
        self._mean = self._zero_parameters(1, network.num_weights)
        self._mean_layers = network.layers(self._mean)
        self._rows: Rows = tuple((zeros(size), zeros(size)) for size in network.sizes[1:]) if shares_noise else ()
        self._normalisation: tuple[Any, Any] = (0.0, 1.0)
        self.moments = Moments.zeros(num_lanes * rows_per_lane, network.sizes[0], xp)
        self.is_recording = False
        """Whether inputs are summed into `moments`."""

    def centre_on(self, level: LevelParameters) -> None:
        """Normalise inputs as `level` does, and set the mean to which shared noise is added to its parameters."""
        xp = self._xp
        self._normalisation = xp.asarray(level.mean), xp.asarray(level.inverse_std)
        if self._rows:
            self._mean[:] = self._network.expand(xp.asarray(level.theta)[None], xp)
            self._mean_layers = self._contiguous(self._mean)

    def start(self, lanes: slice | IntArray, rows: slice | IntArray) -> None:
        """Take over the parameters of `lanes`, and clear the moments of their `rows`."""
        self.moments.clear(rows)
        if self._network.is_tied:
            self._weights[lanes] = self._network.expand(self.theta[lanes], self._xp)
        if self._xp is not np:
            self._layers = self._contiguous(self._weights)
        layers = zip(self._rows, self._mean_layers, self._layers, strict=False)
        for (scales, biases), (_, mean), (_, noise) in layers:
            scales[lanes] = self.scale[lanes]
            biases[lanes] = self.scale[lanes] * noise[lanes] + mean

    def act(
        self,
        inputs: F64Array,
        noise: F32Array | None = None,
        rows: slice | IntArray = slice(None),
        lanes: slice | IntArray = slice(None),
    ) -> F32Array:
        """Return the outputs [rows, A] for the `inputs` [rows, O] of `lanes`, plus `noise` [P, R, A]."""
        if self.is_recording:
            self.moments.add(rows, inputs)
        scaled = normalise(inputs, *self._normalisation, self._clip)
        layers, each_row = self._layers, self._rows
        if not isinstance(lanes, slice):
            # Each row on a cache line, as in theta: the place of a policy must not change its rounding.
            own = np.take(self._weights, lanes, axis=0, out=aligned_rows(len(lanes), self._weights.shape[1]))
            layers = self._network.layers(own)
            each_row = tuple((scales[lanes], biases[lanes]) for scales, biases in each_row)
        observation = scaled.reshape(-1, self._rows_per_lane, scaled.shape[1])
        output = self._network.forward(layers, observation, self._mean_layers, each_row)
        output *= self._limit
        if noise is not None:
            output += noise[lanes]
        return output.reshape(len(inputs), -1)

    def is_finite(self, lane: int) -> bool:
        """Return whether all parameters of a lane are finite."""
        return bool(np.isfinite(self._weights[lane] + self._mean[0]).all())  # the mean is 0 without shared noise

    def _zero_parameters(self, rows: int, size: int) -> F32Array:
        return aligned_rows(rows, size) if self._xp is np else self._xp.zeros((rows, size), np.float32)

    def _contiguous(self, own: F32Array) -> Layers:
        """Return the layers of weights [P, W]: on a GPU as contiguous copies, else it would copy them in every step."""
        layers = self._network.layers(own)
        if self._xp is np:
            return layers
        return tuple((self._xp.ascontiguousarray(weights), biases) for weights, biases in layers)
