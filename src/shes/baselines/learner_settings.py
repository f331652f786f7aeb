"""Settings of HIRO and of flat TD3, and their values in presets.

Source: Nachum et al. 2018 (HIRO), its published code, and Fujimoto et al. 2018 (TD3); SHES paper, Table I. The presets
`hiro-paper` and `hiro-table1` have the published values, with the exceptions in `docs/hiro.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from shes.algorithms.contract import Preset
from shes.envs.gymnasium_ids import BUILTIN_ENVIRONMENTS
from shes.es.statistics import CLIP
from shes.settings import Example, Ge, Gt, Le, Lt, Settings, Shown
from shes.types import F64Array


@dataclass(frozen=True, kw_only=True)
class LearnerSettings(Settings):
    """TD3, of both levels."""

    hidden: Annotated[tuple[int, ...], Ge(1), Example("300 300"), Shown(everyday=True)] = (64, 64)
    """Sizes of the hidden layers of actors and critics (HIRO: 300 300)."""
    actor_learning_rate: Annotated[float, Gt(0)] = 3e-4
    """Learning rate of Adam for the actors (HIRO: 0.0001; Table I: 0.001)."""
    critic_learning_rate: Annotated[float, Gt(0)] = 1e-3
    """Learning rate of Adam for the critics (HIRO: 0.001)."""
    discount: Annotated[float, Ge(0), Lt(1)] = 0.99
    """Discount per transition, at both levels."""
    batch_size: Annotated[int, Ge(1)] = 100
    """Transitions in an update."""
    replay_size: Annotated[int, Ge(1)] = 200_000
    """Most transitions in the replay buffer of each level, all of them in memory and in the checkpoint `last`."""
    target_rate: Annotated[float, Gt(0), Le(1)] = 0.005
    """Interpolation factor of the target-network update (tau)."""
    policy_delay: Annotated[int, Ge(1)] = 2
    """Updates of the critics for one of the actor and of all target networks (HIRO's code: 2; its paper: 1)."""
    noise_unit: Literal["range", "raw"] = "range"
    """Unit of the noises below: range (half the range of each action or goal coordinate, as TD3), or raw (N m, metres
    and so on, as HIRO)."""
    exploration_noise: Annotated[float, Ge(0)] = 0.1
    """Standard deviation of the exploration noise on actions (HIRO: 1 of 30 N m)."""
    reward_scale: Annotated[float, Gt(0)] = 1.0
    """Factor on the environment's reward (HIRO: 0.1). The intrinsic reward is not scaled."""
    bootstrap_terminal: bool = False
    """Whether to bootstrap from terminal states (HIRO's code: yes). A time limit never ends the return, and the
    primitive of HIRO always bootstraps: its rewards are negative, and it would learn to fall."""
    normalise_inputs: bool = True
    """Whether the networks' inputs are normalised by observation statistics (HIRO: no)."""
    num_envs: Annotated[int, Ge(1), Shown(everyday=True)] = 1
    """Environments that feed the learner. The ratio of updates to environment steps stays the same."""
    warmup_steps: Annotated[int, Ge(0)] = 2500
    """Environment steps with random actions and goals before the first update (HIRO: 5 episodes)."""
    update_interval: Annotated[int, Ge(1)] = 10
    """Environment steps between updates; there are as many updates then (HIRO: 1). More take less time per update."""
    generation_steps: Annotated[int, Ge(1), Shown(everyday=True)] = 5000
    """Environment steps of a generation, which ends with the episodes that are then running."""

    @property
    def input_clip(self) -> float:
        """Largest absolute value of an input of the networks."""
        return CLIP if self.normalise_inputs else float("inf")

    def noise_units(self, half_range: tuple[float, ...]) -> F64Array:
        """Return the unit of the noise on each output [A] of an actor, whose outputs have this half range."""
        return np.ones(len(half_range)) if self.noise_unit == "raw" else np.array(half_range)


@dataclass(frozen=True, kw_only=True)
class GoalSettings(Settings):
    """Goals of HIRO."""

    controller_interval: Annotated[int, Ge(1)] = 10
    """Control steps for which a goal is held (c)."""
    goal_distance: Annotated[float, Gt(0)] = 10.0
    """Largest x and y of a goal in metres, relative to the robot."""
    goal_noise: Annotated[float, Ge(0)] = 0.1
    """Standard deviation of the exploration noise on goals (HIRO: 1, raw)."""
    controller_update_interval: Annotated[int, Ge(1)] = 10
    """Environment steps for one update of the controller."""


_HIRO: dict[str, Any] = {
    "hidden": (300, 300),
    "actor_learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "noise_unit": "raw",
    "exploration_noise": 0.1,
    "goal_noise": 1.0,
    "normalise_inputs": False,
    "reward_scale": 0.1,
    "warmup_steps": 2500,
    "update_interval": 1,
    "controller_update_interval": 10,
    "horizon": 500,
    "evaluation_horizon": 500,
    "evaluation_episodes": 50,
    "env_steps": 10_000_000,
    "generations": 1_000_000,
    "generation_steps": 10_000,
    "evaluation_interval": 5,
}
# In raw units the noise of the ant, whose controls are 30 at most, is too much for robots whose controls are 1 at most.
_NOISE = {env: {"exploration_noise": 1.0} for env in BUILTIN_ENVIRONMENTS if env.startswith("ant-")}
# Cells of this maze are 1 m wide.
_SMALL_MAZE = {"robotics-point-maze": {"goal_distance": 1.0, "goal_noise": 0.1}}

HIRO_PRESETS: Mapping[str, Preset] = {
    # Training episodes are as long as evaluation episodes, because policies observe the time.
    "laptop": Preset(values={"horizon": 500}),
    "smoke": Preset(values={"warmup_steps": 1000, "generation_steps": 500}),
    # The values of the HIRO paper and, where it says nothing, of its code; docs/hiro.md has the exceptions.
    "hiro-paper": Preset(
        values=_HIRO,
        per_environment={env: {"spec": "hiro", **_NOISE.get(env, {})} for env in BUILTIN_ENVIRONMENTS} | _SMALL_MAZE,
    ),
    # The same with the values of HIRO in Table I, in the environments of the SHES authors. Their Maze shows the target
    # in units of 100 m, x and y in metres: without normalisation the controller would hardly see it.
    "hiro-table1": Preset(
        values={**_HIRO, "actor_learning_rate": 0.001, "normalise_inputs": True}, per_environment=_NOISE | _SMALL_MAZE
    ),
}
"""Values of both."""
