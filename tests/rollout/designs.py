"""Agents of every kind, with each of their options, for a task that shows 5 values and takes 2 controls."""

from dataclasses import replace

import numpy as np

from shes.agents.agent import FlatDesign
from shes.agents.goal_agent import GoalDesign
from shes.agents.goals import CONTROLLER_OUTPUTS, GOAL_ENCODINGS
from shes.agents.mlp import MLP
from shes.agents.rewards import PRIMITIVE_REWARDS
from shes.agents.views import Clock, ColumnsView
from shes.es.level import LevelParameters
from shes.es.statistics import ObservationStatistics
from shes.options import make

OBSERVED = 5
ACTIONS = 2
INTERVAL = 4
CLOCK = Clock(frequency_hz=1.3, step_s=0.07)
VIEWS = (ColumnsView(), ColumnsView((0, 1, 2)), ColumnsView((3, 0, 4)))
"""Parts of the observation; the last one is no slice."""


def flat(clock=None, hidden=(8,)):
    """Return the design of a policy without goals."""
    inputs = OBSERVED + (clock.size if clock else 0)
    return FlatDesign(networks={"policy": MLP(inputs, hidden, ACTIONS)}, control_limit=1.0, clock=clock)


def primitive(encoding="angle", reward="progress", clock=None, view=VIEWS[0], hidden=(8,), **options):
    """Return the design of a primitive that follows the environment's goals, or recorded ones."""
    inputs = make(GOAL_ENCODINGS, encoding, {}).size + (clock.size if clock else 0) + view.size(OBSERVED)
    design = GoalDesign(
        networks={"primitive": MLP(inputs, hidden, ACTIONS)},
        primitive_view=view,
        goal_encoding=make(GOAL_ENCODINGS, encoding, {}),
        primitive_reward=make(PRIMITIVE_REWARDS, reward, {}),
        controller_interval=INTERVAL,
        control_limit=1.0,
        clock=clock,
    )
    return replace(design, **options)


def both(output="vector", sees=VIEWS[0], hidden=(8,), *, is_minimum=True, distance=4.0, **options):
    """Return the design of a controller with a `primitive`."""
    made = make(CONTROLLER_OUTPUTS, output, {})
    below = primitive(hidden=hidden, **options)
    return replace(
        below,
        networks={"controller": MLP(sees.size(OBSERVED), hidden, made.size), **below.networks},
        controller_view=sees,
        controller_output=made,
        goal_distance=distance,
        has_minimum_goal_distance=is_minimum,
    )


def _turn(choices, number):
    return list(choices)[number % len(choices)]


def every_design():
    """Return designs by name: every pair of encoding and output, and of encoding and view; every reward and clock."""
    found = {"flat": flat(), "flat, clock": flat(CLOCK)}
    for number in range(len(GOAL_ENCODINGS) * len(CONTROLLER_OUTPUTS)):
        options = {
            "encoding": _turn(GOAL_ENCODINGS, number),
            "reward": _turn(PRIMITIVE_REWARDS, number // 2),
            "clock": (None, CLOCK)[number // 4 % 2],
            "view": _turn(VIEWS, number // 3),
        }
        output, name = _turn(CONTROLLER_OUTPUTS, number), f"{options['encoding']}, {options['reward']}, {number}"
        found[f"{output}, {name}"] = both(output, _turn(VIEWS, number), is_minimum=number % 3 > 0, **options)
        if number < len(GOAL_ENCODINGS) * len(VIEWS):
            found[f"alone, {name}"] = primitive(**{**options, "view": _turn(VIEWS, number)})
    found["recorded goals"] = primitive("vector", "cosine", CLOCK, num_recorded_goals=2)
    return found


def thetas_of(design, member, scale=1.0):
    """Return made-up parameters of each level of a member."""
    rng = np.random.default_rng([8, member])
    return [np.float32(scale) * policy.initial(rng, "glorot_normal") for policy in design.policies]


def levels_of(design, scale=1.0):
    """Return made-up mean parameters of each level, with a normalisation that changes every value."""
    rng, levels = np.random.default_rng(9), []
    for theta, size in zip(thetas_of(design, 99, scale), design.observation_sizes, strict=True):
        statistics = ObservationStatistics.empty(size).merge(4, rng.normal(size=size), rng.uniform(4, 9, size))
        levels.append(LevelParameters.of(theta, statistics))
    return tuple(levels)
