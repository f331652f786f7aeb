"""Settings of HIRO and of flat TD3.

Source: Nachum et al. 2018 (HIRO), its published code, and Fujimoto et al. 2018 (TD3). The presets `hiro-paper` and
`hiro-table1` have the published values, with the exceptions in `docs/differences.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from shes.settings import Example, Ge, Gt, Le, Lt, Settings, Shown


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
    critic_loss: Literal["huber", "mse"] = "huber"
    """Loss of the critics: huber (HIRO) or mse (TD3)."""
    noise_unit: Literal["range", "raw"] = "range"
    """Unit of the noises below: range (half the range of each action or goal coordinate, as TD3), or raw (N m, metres
    and so on, as HIRO)."""
    exploration_noise: Annotated[float, Ge(0)] = 0.1
    """Standard deviation of the exploration noise on actions (HIRO: 1 of 30 N m)."""
    target_noise: Annotated[float, Ge(0)] = 0.2
    """Standard deviation of the noise on the target actor's outputs."""
    target_noise_clip: Annotated[float, Ge(0)] = 0.5
    """Largest noise on the target actor's outputs."""
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
    goal_candidates: Annotated[int, Ge(1)] = 10
    """Goals among which the off-policy correction chooses, at every draw; 1 is no correction."""


TD3_SECTIONS: Mapping[str, type[Settings]] = {"learner": LearnerSettings}
"""Settings of one policy without goals."""
HIRO_SECTIONS: Mapping[str, type[Settings]] = {**TD3_SECTIONS, "goals": GoalSettings}
"""Settings of a controller and its primitive."""
