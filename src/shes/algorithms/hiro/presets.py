"""Values of HIRO and TD3 in presets, two of which are their own.

Source: Nachum et al. 2018 (HIRO), appendix C, and its code; SHES paper, Table I.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.presets import Preset
from shes.envs.builtin import BUILTIN_ENVIRONMENTS

_HIRO: dict[str, Any] = {
    "hidden": (300, 300),
    "actor_learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "critic_loss": "huber",
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
    # The values of the HIRO paper and, where it says nothing, of its code; docs/differences.md has the exceptions.
    "hiro-paper": Preset(
        values=_HIRO,
        per_environment={env: {"spec": "hiro", **_NOISE.get(env, {})} for env in BUILTIN_ENVIRONMENTS} | _SMALL_MAZE,
    ),
    # The same with the values of HIRO in Table I, in the environments of the SHES authors. Their Maze shows the target
    # in units of 100 m beside x and y in metres: without normalisation the controller would hardly see it.
    "hiro-table1": Preset(
        values={**_HIRO, "actor_learning_rate": 0.001, "normalise_inputs": True},
        per_environment=_NOISE | _SMALL_MAZE,
    ),
}
"""Values of both."""
