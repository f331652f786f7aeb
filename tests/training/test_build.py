"""What is built from settings: where users' own classes are in play, and where settings of the estimate arrive.

The rest is tested through training.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shes.algorithms.evolution.populations import Settings
from shes.algorithms.worker import WorkerPlan
from shes.envs.bodies.point import Point
from shes.envs.registry import ENVIRONMENTS, Environment
from shes.errors import ShapeError
from shes.es.level import TrainState
from shes.es.shaping import CentredRanks, PairRanks, ZScore
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.outputs import HeadingVectorOutput, VectorOutput
from shes.hierarchy.primitive import PrimitiveDesign
from shes.hierarchy.rewards import MetresReward, ProgressReward
from shes.hierarchy.views import ColumnsView, EgocentricView
from shes.runs.config import TrainConfig
from shes.training.build import build_algorithm
from shes.training.presets import make_config
from tests.e2e.own_classes import Corner


def test_the_plan_carries_the_environment_and_not_its_name(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Corner))
    config = make_config("point-corner", "smoke")
    plan = build_algorithm(config).plan()
    monkeypatch.delitem(ENVIRONMENTS, "point-corner")  # as in a worker process
    assert type(plan.env.make(1)) is Corner
    assert isinstance(plan.noise_table, Path)


class Shy(Corner):
    def observe(self):
        return super().observe()[:, :-1]


def test_an_environment_that_observes_other_values_than_its_spec_names_is_refused(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, Shy))
    message = (
        r"'point-corner' must observe \[N, 6\], .*for 1 episode it observed \(1, 5\)\. Change observation_spec or obs"
    )
    with pytest.raises(ShapeError, match=message):
        build_algorithm(make_config("point-corner", "smoke"))


# Where settings arrive ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Built:
    """Everything that is built from the settings of a run."""

    config: TrainConfig
    design: AgentDesign
    settings: Settings
    plan: WorkerPlan
    state: TrainState

    @classmethod
    def of(cls, env, **settings):
        config = make_config(env, "smoke", settings)
        learner = build_algorithm(config)
        return cls(config, learner.design, learner.settings, learner.plan(), learner.start(config.seed))

    @property
    def intervals(self) -> Any:
        return self.settings.intervals

    @property
    def rules(self):
        return self.settings.updates

    def output_layers(self):
        """Tell of which levels the output layer is zero."""
        return [
            not level.theta[-(policy.sizes[-2] + 1) * policy.sizes[-1] :].any()
            for level, policy in zip(self.state.levels, self.design.policies, strict=True)
        ]


BRANCHED = {"primitive_estimate": "interval", "primitive_view": "egocentric"}
INTERVALS = {**BRANCHED, "population_size": 8, "sigma": 0.2, "learning_rate": 0.04, "horizon": 70}
SCHEDULE = {"sigma_schedule": "linear", "sigma_end": 0.1, "schedule_generations": 2}
ARRIVALS = {
    # setting: (value, where it arrives, what stands there with it, and without it)
    "primitive_sigma": (0.3, lambda b: [b.intervals.sigma.value(g) for g in (0, 9)], [0.3] * 2, [0.2] * 2),
    "primitive_learning_rate": (
        0.07, lambda b: [b.intervals.learning_rate.value(g) for g in (0, 9)], [0.07] * 2, [0.04] * 2
    ),
    "primitive_population_size": (12, lambda b: (b.intervals.population_size, b.intervals.num_pairs), (12, 6), (8, 4)),
    "intervals": (
        3,
        lambda b: (b.intervals.intervals, b.intervals.branch_steps, b.plan.branch_design.num_goals),
        (3, 75, 3),
        (2, 50, 2),
    ),
    "controller_interval": (
        7,
        lambda b: (b.intervals.controller_interval, b.intervals.branch_steps, b.plan.branch_design.controller_interval),
        (7, 14, 7),
        (25, 50, 25),
    ),
    "goal_distance": (2.5, lambda b: (b.intervals.goal_distance, b.design.goal_distance), (2.5, 2.5), (4, 4)),
    "horizon": (90, lambda b: (b.intervals.horizon, b.settings.horizon, b.plan.horizon), (90, 90, 90), (70, 70, 70)),
    "fall_price": (
        3.0, lambda b: (*(r.fall_price for r in b.rules), b.intervals.update.fall_price), (0, 3, 3), (0, 0, 0)
    ),
    "primitive_fitness_shaping": (
        "z_score",
        lambda b: [type(r.shaping) for r in (*b.rules, b.intervals.update)],
        [CentredRanks, ZScore, ZScore],
        [CentredRanks, PairRanks, PairRanks],
    ),
    "hold_tied": (
        False, lambda b: [r.holds_when_tied for r in (*b.rules, b.intervals.update)], [False] * 3, [True] * 3
    ),
    "weight_decay_form": (
        "decoupled", lambda b: [r.decouples_decay for r in (*b.rules, b.intervals.update)], [True] * 3, [False] * 3
    ),
    "controller_weight_decay": (
        0.5,
        lambda b: [r.weight_decay for r in (*b.rules, b.intervals.update)],
        [0.5, 0.005, 0.005],
        [0.005] * 3,
    ),
    "output_weights": ("zero", lambda b: b.output_layers(), [True, True], [False, False]),
    "symmetry": (
        "rotation",
        lambda b: [d.symmetry and d.symmetry.num_elements for d in (b.design, b.plan.branch_design)],
        [4, 4],
        [None, None],
    ),
    "controller_view": (
        "egocentric", lambda b: type(b.design.controller_view), EgocentricView, ColumnsView
    ),
    "primitive_view": (
        "proprioception",
        lambda b: [type(d.primitive_view) for d in (b.design, b.plan.branch_design)],
        [ColumnsView] * 2,
        [EgocentricView] * 2,
    ),
    "controller_output": (
        "heading_vector", lambda b: type(b.design.controller_output), HeadingVectorOutput, VectorOutput
    ),
    "primitive_reward": (
        "metres",
        lambda b: [type(d.primitive_reward) for d in (b.design, b.plan.branch_design)],
        [MetresReward] * 2,
        [ProgressReward] * 2,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def beside():
    """What is built for a primitive that is judged by intervals beside a controller."""
    return Built.of("ant-gather", **INTERVALS)


@pytest.mark.parametrize("name", ARRIVALS)
def test_a_setting_of_the_estimate_arrives_where_it_is_used(beside, name):
    value, place, expected, usual = ARRIVALS[name]
    assert place(Built.of("ant-gather", **{**INTERVALS, name: value})) == expected != usual
    assert place(beside) == usual


@pytest.mark.parametrize("symmetry", ["rotation", "dihedral"])
def test_agents_get_the_elements_of_the_symmetry_that_is_asked_for(symmetry):
    built = Built.of("ant-flagrun", primitive_view="egocentric", symmetry=symmetry)
    assert built.design.symmetry.num_elements == {"rotation": 4, "dihedral": 8}[symmetry]


def test_what_acts_in_branches_is_the_primitive_of_the_runs_agent(beside):
    branch = beside.plan.branch_design
    for field in fields(PrimitiveDesign):
        assert getattr(branch, field.name) is getattr(beside.design, field.name)
    assert branch.dims == beside.design.dims[1:]


def test_a_primitive_alone_acts_in_branches_as_everywhere_and_has_the_runs_own_rates():
    built = Built.of("ant-flagrun", **INTERVALS, **SCHEDULE, fall_price=2.0)
    assert built.plan.branch_design is None
    estimate = built.intervals
    assert (estimate.population_size, estimate.update.fall_price) == (8, 2)
    assert [estimate.sigma.value(g) for g in range(4)] == pytest.approx([0.2, 0.15, 0.1, 0.1])
    assert [estimate.sigma.value(g) for g in range(4)] == [built.settings.sigma.value(g) for g in range(4)]
    assert estimate.learning_rate.value(0) == 0.04
    assert estimate.update == built.rules[0]


def test_without_rates_of_its_own_a_primitive_beside_a_controller_has_the_runs():
    built = Built.of("ant-gather", **INTERVALS, **SCHEDULE)
    assert [built.intervals.sigma.value(g) for g in range(3)] == pytest.approx([0.2, 0.15, 0.1])
    own = Built.of("ant-gather", **INTERVALS, **SCHEDULE, primitive_sigma=0.3)
    assert [own.intervals.sigma.value(g) for g in range(3)] == [0.3] * 3
    assert [own.settings.sigma.value(g) for g in range(3)] == pytest.approx([0.2, 0.15, 0.1])


def test_by_whole_episodes_there_is_nothing_of_the_estimate():
    built = Built.of("ant-gather", fall_price=2.0)
    assert built.intervals is None
    assert built.plan.branch_design is None
    assert built.settings.by_episodes == (True, True)
    assert [rule.fall_price for rule in built.rules] == [0, 2]  # falls of whole episodes have their price, too


def test_by_intervals_whole_episodes_judge_the_controller_alone(beside):
    assert (beside.settings.learns, beside.settings.by_episodes) == ((True, True), (True, False))
    assert np.array_equal(np.abs(beside.settings.signs(0)).max(axis=(0, 1)), [1, 0])
