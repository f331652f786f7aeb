"""Multilayer perceptron whose weights are tied by a symmetry group: transformed inputs give transformed outputs.

A group acts on the units of every layer by signed permutations. The network commutes with these actions exactly if the
weights that an action maps onto each other are equal, up to sign. Each such orbit is one parameter. The parameters are
what evolution perturbs and stores; they are expanded to the weights of an ordinary `MLP` when episodes start.

Source: Ravanbakhsh et al. 2017 (equivariance through parameter-sharing), section 3; Cohen and Welling 2016.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from types import ModuleType
from typing import TypeAlias

import numpy as np

from shes.agents.mlp import MLP
from shes.types import F32Array, F64Array, IntArray

Action: TypeAlias = tuple[IntArray, F64Array]
"""Signed permutation (source, sign) of the units of a layer, both [units]: `new[i] = sign[i] * old[source[i]]`."""


def sector_actions(num_sectors: int, num_channels: int) -> tuple[Action, Action]:
    """Return how a turn by one sector and a reflection act on channels of values around a robot.

    Units are ordered by channel, then by sector, counter-clockwise from straight behind. The two generate the dihedral
    group of `num_sectors` rotations and as many reflections.
    """
    units = np.arange(num_channels * num_sectors).reshape(num_channels, num_sectors)
    sign = np.ones(units.size)
    return (np.roll(units, 1, axis=1).ravel(), sign), (units[:, ::-1].ravel(), sign)


class EquivariantMLP(MLP):
    """A network with tied weights. Its parameters [D] are one value for each orbit of weights and biases."""

    is_tied = True

    def __init__(self, actions: Sequence[Sequence[Action]]) -> None:
        """Create a network whose layers have the units on which `actions` act, by layer and generator, inputs first.

        All layers have the same number of generators, in the same order. Hidden layers and outputs go through tanh,
        which is odd and acts on each unit alone, so it commutes with signed permutations.
        """
        sizes = [len(of_layer[0][0]) for of_layer in actions]
        super().__init__(sizes[0], tuple(sizes[1:-1]), sizes[-1])
        trivial = [(np.zeros(1, np.int64), np.ones(1))] * len(actions[0])
        index, sign, first = list[IntArray](), list[F64Array](), list[IntArray]()
        num_weights = num_params = 0
        for inputs, outputs in pairwise(actions):
            for sources in (inputs, trivial):  # weights, then biases
                orbit, own = _orbits(sources, outputs)
                heads, number = np.unique(orbit[own != 0], return_inverse=True)
                index.append(np.zeros(len(orbit), np.int64))
                index[-1][own != 0] = num_params + number
                sign.append(own)
                first.append(num_weights + heads)
                num_weights, num_params = num_weights + len(orbit), num_params + len(heads)
        self.num_weights, self.num_params = num_weights, num_params
        self.index: IntArray = np.concatenate(index)
        """Parameter of each weight and bias of the network [W]."""
        self.sign: F32Array = np.concatenate(sign).astype(np.float32)
        """+1 or -1 [W], or 0 for weights that the symmetry forbids."""
        self._first = np.concatenate(first)
        self._input_orbit, self._input_sign = _orbits(actions[0], trivial)

    def expand(self, theta: F32Array, xp: ModuleType = np) -> F32Array:
        """Return the weights and biases [P, W] of policies `theta` [P, D], arrays of `xp`."""
        return theta[:, xp.asarray(self.index)] * xp.asarray(self.sign)

    def pool(self, total: F64Array, total_squares: F64Array) -> None:
        """Average sums over observations [O] in place over the inputs that the symmetry exchanges.

        The normalisation is then the same for all of them, so that it commutes with the symmetry as well.
        """
        orbit, sign, count = self._input_orbit, self._input_sign, np.bincount(self._input_orbit)
        total[:] = sign * (np.bincount(orbit, sign * total) / np.maximum(count, 1))[orbit]
        total_squares[:] = (np.bincount(orbit, total_squares) / np.maximum(count, 1))[orbit]


def _orbits(inputs: Sequence[Action], outputs: Sequence[Action]) -> tuple[IntArray, F64Array]:
    """Return for each weight [inputs * outputs] the first weight of its orbit, and its sign relative to that one.

    Generator by generator, `W[i, o] = sign_in[i] * sign_out[o] * W[source_in[i], source_out[o]]`. The sign is 0 if an
    orbit contains a weight and its negative.
    """
    width = len(outputs[0][0])
    maps = [
        ((source[:, None] * width + to[None]).ravel(), np.outer(sign, to_sign).ravel())
        for (source, sign), (to, to_sign) in zip(inputs, outputs, strict=True)
    ]
    orbit = np.arange(len(maps[0][0]))
    own = np.ones(len(orbit))
    has_changed = True
    while has_changed:
        has_changed = False
        for source, sign in maps:
            lower = orbit[source] < orbit
            own = np.where(lower, sign * own[source], own)
            orbit = np.where(lower, orbit[source], orbit)
            has_changed |= bool(lower.any())
    forbidden = np.unique(np.concatenate([orbit[own != sign * own[source]] for source, sign in maps]))
    return orbit, np.where(np.isin(orbit, forbidden), 0.0, own)
