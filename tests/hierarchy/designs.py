"""Every kind of agent with each of its options, for a task that shows 5 values and takes 2 controls."""

from itertools import product

from shes.hierarchy.clock import Clock
from shes.hierarchy.flat import FlatDesign
from shes.hierarchy.goals import GOAL_ENCODINGS, make_goal_encoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.outputs import CONTROLLER_OUTPUTS, make_controller_output
from shes.hierarchy.primitive import PrimitiveDesign
from shes.hierarchy.rewards import PRIMITIVE_REWARDS, make_primitive_reward
from shes.hierarchy.views import ColumnsView
from shes.policies.mlp import MLP

OBSERVED = 5
ACTIONS = 2
INTERVAL = 4
CLOCK = Clock(frequency_hz=1.3, step_s=0.1)
VIEWS = {"all": ColumnsView(), "first three": ColumnsView((0, 1, 2)), "picked": ColumnsView((3, 0, 4))}
"""What the primitive sees of the observation; the last one is no slice."""


def flat(clock=None, hidden=(8,)):
    """Return the design of a policy without goals."""
    inputs = OBSERVED + (clock.size if clock else 0)
    return FlatDesign(policy=MLP(inputs, hidden, ACTIONS), control_limit=1.0, clock=clock)


def _reaching(encoding, clock, view, hidden, reward):
    features = make_goal_encoding(encoding).size + (clock.size if clock else 0)
    seen = VIEWS[view].size(OBSERVED)
    return {
        "primitive": MLP(features + seen, hidden, ACTIONS),
        "primitive_view": VIEWS[view],
        "goal_encoding": make_goal_encoding(encoding),
        "primitive_reward": make_primitive_reward(reward),
        "controller_interval": INTERVAL,
        "control_limit": 1.0,
        "clock": clock,
    }


def primitive(encoding="angle", clock=None, view="all", hidden=(8,), reward="progress"):
    """Return the design of a primitive that follows the environment's goals."""
    return PrimitiveDesign(**_reaching(encoding, clock, view, hidden, reward))


def hierarchical(
    encoding="angle", output="vector", clock=None, view="all", hidden=(8,), reward="progress", *, is_minimum=True
):
    """Return the design of a controller with its primitive."""
    made = make_controller_output(output)
    return HierarchicalDesign(
        controller=MLP(OBSERVED, hidden, made.size),
        controller_output=made,
        goal_distance=4.0,
        has_minimum_goal_distance=is_minimum,
        **_reaching(encoding, clock, view, hidden, reward),
    )


def every_design():
    """Return every design by a name that says what it is, with whether it is one of a few that have every option."""
    found = {"flat": (flat(), True), "flat, clock": (flat(CLOCK), True)}
    for number, (encoding, view, clock) in enumerate(product(GOAL_ENCODINGS, VIEWS, (None, CLOCK))):
        options = f"sees {view}{', clock' if clock else ''}"
        found[f"primitive, {encoding}, {options}"] = (primitive(encoding, clock, view), number % 7 == 0)
        for other, output in enumerate(CONTROLLER_OUTPUTS):
            design = hierarchical(encoding, output, clock, view)
            found[f"hierarchical, {encoding}, {output}, {options}"] = (design, number % 7 == 1 + 3 * other)
    for reward in PRIMITIVE_REWARDS:
        found[f"primitive, {reward}"] = (primitive(reward=reward), False)
        found[f"hierarchical, {reward}"] = (hierarchical(reward=reward), reward != "progress")
    return found
