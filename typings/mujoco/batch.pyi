# For pyright: the part of mujoco.batch that is used here. N simulations, S state entries.
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

class Batch:
    model: mujoco.MjModel
    state: NDArray[np.float64]  # [N, S]
    warning: NDArray[np.int32]  # [N, kinds, (last info, count)]
    status: NDArray[np.int32]  # [N]
    def __init__(self, model: mujoco.MjModel, nsim: int, nthread: int = 0, persistent: bool = False) -> None: ...
    def bind(self, name: str) -> NDArray[Any]: ...
    def step(self, ids: ArrayLike | None = None, nstep: int = 1, stage: int = ...) -> None: ...
    def forward(self, ids: ArrayLike | None = None, stage: int = ...) -> None: ...
    def reset(self, ids: ArrayLike | None = None, keyframe: ArrayLike = -1, stage: int = ...) -> None: ...
