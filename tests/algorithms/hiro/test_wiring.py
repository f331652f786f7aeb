"""Where every setting of HIRO and TD3 arrives. A setting without a row fails."""

from types import SimpleNamespace
from unittest import mock

import pytest

from shes.algorithms.hiro import algorithm
from shes.algorithms.hiro.sections import HIRO_SECTIONS
from shes.runs.build import build_algorithm
from shes.settings import setting_fields
from shes.training.make_config import make_config


def hyper(name):
    """Return what reads a hyperparameter of both levels."""
    return lambda a: [getattr(level.hyperparameters, name) for level in a.levels]


def first(read):
    """Return what reads the first output's value of a tuple of both levels."""
    return lambda a: [read(level)[0] for level in a.levels]


def due(level):
    """Return what counts the updates of a level in 60 steps, by call."""
    return lambda a: [count for name, count in a.updates_due(0, 60) if name == level]


def collected(name):
    """Return what reads an attribute of the collector."""

    def read(a):
        batch = a.problem.env.make(a.settings.num_envs, a.problem.training)
        return getattr(a.make_collector(batch, {}), name)

    return read


def _controller_learner(a):
    """Return the arguments of the controller's learner."""
    made = SimpleNamespace(LevelLearner=lambda *_: None, ControllerLearner=lambda *arguments: arguments)
    with mock.patch.object(algorithm, "import_learning", return_value=made):
        return a.make_learners(SimpleNamespace(learners=(None, None)))["controller"]


ROWS = {
    # setting: (value, what reads it, what that finds)
    "hidden": ((9, 8), lambda a: [level.actor.sizes[1:-1] for level in a.levels], [(9, 8)] * 2),
    "actor_learning_rate": (0.5, hyper("actor_learning_rate"), [0.5, 0.5]),
    "critic_learning_rate": (0.6, hyper("critic_learning_rate"), [0.6, 0.6]),
    "discount": (0.7, lambda a: a._learning()[0], 0.7),
    "batch_size": (33, lambda a: a._learning()[1], 33),
    "replay_size": (777, lambda a: [level.replay.capacity for level in a.levels], [777, 777]),
    "target_rate": (0.25, hyper("target_rate"), [0.25, 0.25]),
    "policy_delay": (5, hyper("policy_delay"), [5, 5]),
    "critic_loss": ("mse", hyper("has_huber_loss"), [False, False]),
    "noise_unit": ("raw", first(lambda level: level.hyperparameters.noise_std), [0.2, 0.2]),
    "exploration_noise": (0.5, lambda a: a.levels[1].exploration_std, (0.5, 0.5)),
    "goal_noise": (0.5, lambda a: a.levels[0].exploration_std, (5.0, 5.0)),
    "target_noise": (0.5, first(lambda level: level.hyperparameters.noise_std), [5.0, 0.5]),
    "target_noise_clip": (0.3, first(lambda level: level.hyperparameters.noise_clip), [3.0, 0.3]),
    "reward_scale": (0.5, collected("_reward_scale"), 0.5),
    "bootstrap_terminal": (True, collected("_bootstraps"), True),
    "normalise_inputs": (False, lambda a: a.design.input_clip, float("inf")),
    "num_envs": (3, lambda a: collected("_batch")(a).num_episodes, 3),
    "warmup_steps": (90_000, lambda a: a.levels[0].replay.slack, 90_500),
    "generation_steps": (80_000, lambda a: a.levels[0].replay.slack, 80_500),
    "update_interval": (20, due("primitive"), [20, 20, 20]),
    "controller_update_interval": (30, due("controller"), [1, 1]),
    "controller_interval": (4, lambda a: a.design.controller_interval, 4),
    "goal_distance": (3.0, lambda a: a.design.goals.half_range, (3.0, 3.0)),
    "goal_candidates": (6, lambda a: _controller_learner(a)[-1], 6),
}


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_arrives_where_it_is_used(name):
    value, read, expected = ROWS[name]
    with_it, without = (
        read(build_algorithm(make_config("point-maze", "laptop", {"algorithm": "hiro", **settings})))
        for settings in ({name: value}, {})
    )
    assert with_it == expected != without


def test_every_setting_has_a_row():
    assert {name for section in HIRO_SECTIONS.values() for name in setting_fields(section)} == ROWS.keys()
