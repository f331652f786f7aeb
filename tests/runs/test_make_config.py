"""Presets: what they start from, by numbers written down by hand."""

import math

import pytest

from shes.envs.named_environments import ENVIRONMENTS
from shes.errors import ConfigError
from shes.runs.build import build_options
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import PRESET_NAMES

PAPER = {
    # SHES paper, Table I.
    "population_size": 1000, "episodes_per_policy": 5, "horizon": 500, "controller_interval": 25, "goal_distance": 4.0,
    "learning_rate": 0.01, "sigma_end": None, "learning_rate_end": None, "sigma": 0.02, "generations": 3000,
    # Where Table I is silent: the authors' code (docs/differences.md).
    "hidden": (256, 256, 256), "biases": "glorot_normal", "weight_decay": 0.005, "mirrored": "quad",
    "rank_ties": "index", "common_random_numbers": "off", "statistics_fraction": 0.01, "minimum_goal_distance": True,
    "goal_encoding": "angle", "controller_output": "vector", "perturbation": "many_to_many",
    "fitness_shaping": "centred_rank", "optimizer": "adam", "primitive_reward": "progress",
    # What makes the ant learn in the other presets is not the paper's (docs/learning.md).
    "primitive_view": "observation", "controller_view": "observation", "symmetry": "none", "clock_frequency": None,
    "primitive_estimate": "episode", "output_weights": "glorot_normal", "max_tilt": None, "waypoints": None,
    "explore": "none", "freeze_primitive": True, "reset_noise": 0.0, "evaluation_episodes": 10,
    "noise_table_size": 250_000_000,
}  # fmt: skip


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_the_paper_preset_has_the_numbers_of_table_one(env):
    values = make_config(env, "paper").values
    expected = {**PAPER, "population_size": 256} if env in ("ant-flagrun", "point-flagrun") else PAPER
    shared = expected.keys() & values.keys()
    assert {name: values[name] for name in shared} == {name: expected[name] for name in shared}
    assert "flagrun" in env or expected.keys() - shared <= {"max_tilt", "waypoints"}


def test_the_paper_preset_evaluates_as_it_trains():
    config = make_config("ant-gather", "paper")
    assert config.evaluation_steps == 500
    for is_evaluation, noise in ((False, 0.0), (True, 0.1)):
        options = build_options(config, is_evaluation=is_evaluation)
        assert (options.integrator, options.reset_noise) == ("euler", noise)


@pytest.mark.parametrize("preset", PRESET_NAMES)
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_every_preset_suits_every_environment(env, preset):
    if "hiro" in preset and "flagrun" in env:
        with pytest.raises(ConfigError, match=f"{env} sets the goals, so the controller of hiro has nothing to learn"):
            make_config(env, preset)
        return
    config = make_config(env, preset)
    assert (config.run.env, config.run.preset) == (env, preset)
    if "hiro" not in preset:  # it may set what has no effect
        assert make_config(env, preset, {"algorithm": "es"}).run.preset == preset


@pytest.mark.parametrize(
    ("preset", "algorithm", "message"),
    [
        ("paper", "hiro", r"for algorithm shes or es, got algorithm 'hiro'\. Set --preset laptop, smoke, hiro-paper, "),
        ("hiro-paper", "es", r"for algorithm hiro or td3, got algorithm 'es'\. Set --preset"),
    ],
)
def test_a_preset_is_for_the_algorithms_that_have_it(preset, algorithm, message):
    with pytest.raises(ConfigError, match=rf"preset '{preset}' is {message}"):
        make_config("ant-maze", preset, {"algorithm": algorithm})


def test_a_preset_of_hiro_brings_its_algorithm():
    assert make_config("ant-maze", "hiro-paper").run.algorithm == "hiro"
    assert make_config("ant-maze", "hiro-paper", {"algorithm": "td3"}).learner.hidden == (300, 300)


def test_the_presets_of_hiro_have_the_published_numbers():
    config = make_config("ant-maze", "hiro-paper")
    published = {
        "hidden": (300, 300), "batch_size": 100, "replay_size": 200_000, "actor_learning_rate": 1e-4,
        "critic_learning_rate": 1e-3, "discount": 0.99, "target_rate": 0.005, "policy_delay": 2,
        "exploration_noise": 1.0, "goal_noise": 1.0, "noise_unit": "raw", "controller_interval": 10,
        "goal_distance": 10.0, "reward_scale": 0.1, "spec": "hiro", "horizon": 500, "env_steps": 10_000_000,
        "normalise_inputs": False, "bootstrap_terminal": False, "update_interval": 1,
        "controller_update_interval": 10, "warmup_steps": 2500, "evaluation_episodes": 50,
    }  # fmt: skip
    assert config.values.items() >= published.items()
    assert config.learner.generation_steps * config.evaluation.evaluation_interval == 50_000
    assert make_config("point-maze", "hiro-paper").learner.exploration_noise == 0.1
    table = make_config("ant-maze", "hiro-table1")
    assert (table.learner.actor_learning_rate, table.environment.spec) == (0.001, "shes")
    assert table.learner.normalise_inputs  # the target in that observation is 100 times smaller than the position


@pytest.mark.extras
@pytest.mark.parametrize("preset", ["hiro-paper", "hiro-table1"])
def test_the_presets_of_hiro_fit_a_small_maze(preset):
    pytest.importorskip("gymnasium_robotics")
    config = make_config("robotics-point-maze", preset)
    assert (config.learner.exploration_noise, config.goals.goal_distance, config.goals.goal_noise) == (0.1, 1.0, 0.1)


def test_the_smoke_preset_is_small():
    values = make_config("ant-gather", "smoke").values
    factors = ("generations", "population_size", "episodes_per_policy", "horizon")
    assert math.prod(values[name] for name in factors) <= 10_000
    assert values["noise_table_size"] <= 1_000_000


def test_overrides_win_over_the_preset():
    config = make_config("point-gather", "paper", {"sigma": 0.5, "hidden": [8]})
    assert (config.evolution.sigma, config.networks.hidden, config.evolution.population_size) == (0.5, (8,), 1000)
    assert make_config("point-gather", "smoke", {"hidden": 8}).networks.hidden == (8,)


OF_INTERVALS = r"is evaluated by intervals: it applies to whole episodes only; .*--primitive-estimate episode"
ON_WALKER = {"primitive": "ant-walker"}
FROZEN = r"{name} has no effect on a frozen primitive; got {value}"
IDLE = [
    # Environment; a setting that has no effect, and others; the message; what helps.
    ("point-gather", {"rank_ties": "index", "fitness_shaping": "pair_rank", "mirrored": "pair"},
     "{name} has no effect with fitness_shaping 'pair_rank', got 'index'. Set --fitness-shaping to centred_rank",
     {"fitness_shaping": "centred_rank"}),
    ("point-gather", {"schedule_generations": 50},
     "{name} has no effect with sigma_end None, learning_rate_end None, got 50.*omit --sched", {"sigma_end": 0.01}),
    ("ant-gather", {"freeze_primitive": False},
     r"{name} has no effect with primitive None, got False\. Set --primitive, or omit --freeze-primitive", ON_WALKER),
    ("point-gather", {"primitive_checkpoint": "last"},
     "{name} has no effect with primitive None.*omit --primitive-checkpoint", None),
    ("ant-maze", {"explore_horizon": 900, "explore": "none"},
     "{name} has no effect with explore 'none', got 900", {"explore": "archive"}),
    ("ant-gather", {"perturbation": "one_to_many"},
     "needs two levels evaluated by whole episodes; in this run only the controller is; got 'one_to_many'",
     {"primitive_estimate": "episode"}),
    ("ant-gather", {"perturbation": "one_to_many", **ON_WALKER},
     "--{name} needs two learning levels; in this run only the controller learns", None),
    *(("ant-flagrun", each, "{name} .* " + OF_INTERVALS, {"primitive_estimate": "episode"}) for each in (
        {"fitness_shaping": "centred_rank"}, {"mirrored": "none"}, {"episodes_per_policy": 5},
        {"common_random_numbers": "off"}, {"statistics_fraction": 0.0})),
    *(("ant-gather", {**each, **ON_WALKER}, FROZEN, {"freeze_primitive": False}) for each in (
        {"intervals": 5}, {"fall_price": 0.0}, {"primitive_sigma": 0.3}, {"primitive_population_size": 6})),
    *(("gymnasium:shes/PointMaze-v0", each, "{name} has no effect on gymnasium:.* its own physics", None) for each in (
        {"reset_noise": 0.0}, {"spec": "shes"})),
]  # fmt: skip


@pytest.mark.parametrize(("env", "settings", "message", "helps"), IDLE, ids=str)
def test_a_setting_without_effect_is_refused_with_what_helps(env, settings, message, helps):
    name, value = next(iter(settings.items()))
    with pytest.raises(ConfigError, match=message.format(name=name, value=value)):
        make_config(env, "laptop", settings)
    if helps is not None:
        helped = {**settings, **helps}
        assert {name: make_config(env, "laptop", helped).values[name] for name in helped} == helped
