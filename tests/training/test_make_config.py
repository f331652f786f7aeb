"""Presets: what they start from, by numbers written down by hand."""

import pytest

from shes.algorithms.registry import PRESET_NAMES
from shes.envs.registry import ENVIRONMENTS
from shes.errors import ConfigError, UnknownNameError
from shes.training.build import build_options
from shes.training.make_config import make_config

PAPER = {
    # SHES paper, Table I.
    "population_size": 1000,
    "episodes_per_policy": 5,
    "horizon": 500,
    "controller_interval": 25,
    "goal_distance": 4.0,
    "learning_rate": 0.01,
    "sigma": 0.02,
    "generations": 3000,
    # Where Table I is silent: the authors' code (docs/differences.md).
    "hidden": (256, 256, 256),
    "biases": "glorot_normal",
    "weight_decay": 0.005,
    "mirrored": "quad",
    "rank_ties": "index",
    "common_random_numbers": "off",
    "statistics_fraction": 0.01,
    "minimum_goal_distance": True,
    "goal_encoding": "angle",
    "controller_output": "vector",
    "perturbation": "many_to_many",
    "fitness_shaping": "centred_rank",
    "optimizer": "adam",
    "primitive_reward": "progress",
    # What makes the ant learn in the other presets is not the paper's (docs/learning.md).
    "primitive_view": "observation",
    "controller_view": "observation",
    "symmetry": "none",
    "clock_frequency": None,
    "primitive_estimate": "episode",
    "output_weights": "glorot_normal",
    "weight_decay_form": "gradient",
    "hold_tied": False,
    "learning_rate_schedule": "constant",
    "sigma_schedule": "constant",
    "max_tilt": None,
    "waypoints": None,
    "explore": "none",
    "freeze_primitive": True,
    "reset_noise": 0.0,
    "evaluation_reset_noise": 0.1,
    "evaluation_episodes": 10,
    "noise_table_size": 250_000_000,
}


@pytest.mark.parametrize("env", ENVIRONMENTS)
@pytest.mark.parametrize("name", PAPER)
def test_the_paper_preset_has_the_numbers_of_table_one(env, name):
    is_pretraining = (name, env) in (("population_size", "ant-flagrun"), ("population_size", "point-flagrun"))
    assert make_config(env, "paper").values.get(name, PAPER[name]) == (256 if is_pretraining else PAPER[name])


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_the_paper_preset_steps_by_euler(env):
    config = make_config(env, "paper")
    assert build_options(config, is_evaluation=False).integrator == "euler"


def test_the_paper_preset_evaluates_over_the_horizon_of_table_one():
    config = make_config("ant-gather", "paper")
    assert (config.episodes.evaluation_horizon or config.episodes.horizon) == 500


@pytest.mark.parametrize("preset", PRESET_NAMES)
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_every_preset_suits_every_environment(env, preset):
    if "hiro" in preset and "flagrun" in env:
        with pytest.raises(ConfigError, match=f"{env} sets the goals, so the controller of hiro has nothing to learn"):
            make_config(env, preset)
        return
    config = make_config(env, preset)
    assert (config.run.env, config.run.preset) == (env, preset)


def test_the_preset_of_table_one_is_for_evolution_alone():
    """For HIRO it would be a mixture that nobody published."""
    fix = r"Set --preset laptop, smoke, hiro-paper, hiro-table1, or omit --algorithm"
    with pytest.raises(ConfigError, match=rf"preset 'paper' is for algorithm shes or es, got algorithm 'hiro'\. {fix}"):
        make_config("ant-maze", "paper", {"algorithm": "hiro"})


def test_a_preset_of_hiro_brings_its_algorithm():
    assert make_config("ant-maze", "hiro-paper").run.algorithm == "hiro"
    assert make_config("ant-maze", "hiro-paper", {"algorithm": "td3"}).learner.hidden == (300, 300)
    message = r"preset 'hiro-paper' is for algorithm hiro or td3, got algorithm 'es'\. Set --preset"
    with pytest.raises(ConfigError, match=message):
        make_config("ant-maze", "hiro-paper", {"algorithm": "es"})


def test_the_presets_of_hiro_have_the_published_numbers():
    config = make_config("ant-maze", "hiro-paper")
    learner, goals = config.learner, config.goals
    assert (learner.hidden, learner.batch_size, learner.replay_size) == ((300, 300), 100, 200_000)
    assert (learner.actor_learning_rate, learner.critic_learning_rate) == (1e-4, 1e-3)
    assert (learner.discount, learner.target_rate, learner.policy_delay) == (0.99, 0.005, 2)
    assert (learner.exploration_noise, goals.goal_noise, learner.noise_unit) == (1.0, 1.0, "raw")
    assert (goals.controller_interval, goals.goal_distance, learner.reward_scale) == (10, 10.0, 0.1)
    assert (config.environment.spec, config.episodes.horizon, config.run.env_steps) == ("hiro", 500, 10_000_000)
    assert (learner.normalise_inputs, learner.bootstrap_terminal) == (False, False)
    assert (learner.update_interval, goals.controller_update_interval, learner.warmup_steps) == (1, 10, 2500)
    assert learner.generation_steps * config.evaluation.evaluation_interval == 50_000
    assert config.evaluation.evaluation_episodes == 50
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


def test_the_presets_are_those_of_the_design():
    assert set(PRESET_NAMES) == {"paper", "laptop", "smoke", "hiro-paper", "hiro-table1"}


def test_the_smoke_preset_is_small():
    config = make_config("ant-gather", "smoke")
    steps = (
        config.run.generations
        * config.evolution.population_size
        * config.evolution.episodes_per_policy
        * config.episodes.horizon
    )
    assert steps <= 10_000
    assert config.evolution.noise_table_size <= 1_000_000


def test_overrides_win_over_the_preset():
    config = make_config("point-gather", "paper", {"sigma": 0.5, "hidden": [8]})
    assert (config.evolution.sigma, config.networks.hidden, config.evolution.population_size) == (0.5, (8,), 1000)
    assert make_config("point-gather", "smoke", {"hidden": 8}).networks.hidden == (8,)


def test_wrong_names_are_refused():
    with pytest.raises(UnknownNameError, match=r"unknown preset 'papper'\. Did you mean 'paper'\?.*Set --preset"):
        make_config("ant-gather", "papper")
    with pytest.raises(ConfigError, match=r"unknown setting 'lerning_rate'\. Did you mean 'learning_rate'\?"):
        make_config("ant-gather", "smoke", {"lerning_rate": 1})


@pytest.mark.parametrize(
    ("settings", "fix"),
    [
        ({"momentum": 0.5}, "momentum has no effect with optimizer 'adam'.*Set --optimizer to sgd or clipup"),
        ({"top_fraction": 0.5}, "top_fraction has no effect with fitness_shaping 'centred_rank'.*--fitness-shaping"),
        (
            {"rank_ties": "index", "fitness_shaping": "z_score"},
            "rank_ties has no effect with fitness_shaping 'z_score'",
        ),
        (
            {"schedule_generations": 50},
            "schedule_generations has no effect with learning_rate_end None, .*, got 50.*omit --sched",
        ),
        (
            {"perturbation": "one_to_many", "algorithm": "es"},
            "perturbation is not a setting of a run of point-gather with algorithm 'es', got 'one_to_many'. Omit --",
        ),
    ],
)
def test_a_setting_that_would_do_nothing_beside_another_is_refused(settings, fix):
    with pytest.raises(ConfigError, match=fix):
        make_config("point-gather", "laptop", settings)
    helped = {
        "momentum": {"optimizer": "sgd"},
        "schedule_generations": {"sigma_schedule": "linear", "sigma_end": 0.01},
        "perturbation": {"algorithm": "shes"},
    }.get(next(iter(settings)))
    if helped is not None:
        make_config("point-gather", "laptop", {**settings, **helped})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("fitness_shaping", "z_score"),
        ("mirrored", "none"),
        ("episodes_per_policy", 5),
        ("common_random_numbers", "off"),
        ("statistics_fraction", 0.1),
    ],
)
def test_what_concerns_whole_episodes_is_refused_where_there_are_none(name, value):
    message = rf"{name} .* is evaluated by intervals: it applies to whole episodes only; .*--primitive-estimate episode"
    with pytest.raises(ConfigError, match=message):
        make_config("ant-flagrun", "laptop", {name: value})
    chosen = make_config("ant-flagrun", "laptop", {name: value, "primitive_estimate": "episode"})
    assert chosen.values[name] == value


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "needs two levels evaluated by whole episodes; in this run only the controller is; got 'one_to_many'"),
        (
            {"primitive": "ant-walker"},
            "--perturbation needs two learning levels; in this run only the controller l",
        ),
    ],
)
def test_two_levels_that_do_not_both_learn_from_whole_episodes_do_not_share_the_population(settings, message):
    with pytest.raises(ConfigError, match=message):
        make_config("ant-gather", "laptop", {"perturbation": "one_to_many", **settings})


def test_options_of_a_shaping_may_concern_the_primitives():
    own = {"primitive_fitness_shaping": "top_fraction", "top_fraction": 0.3}
    assert make_config("ant-gather", "laptop", own).evolution.top_fraction == 0.3


@pytest.mark.parametrize(
    ("name", "value"),
    [("intervals", 5), ("fall_price", 5.0), ("primitive_sigma", 0.3), ("primitive_population_size", 6)],
)
def test_what_concerns_branches_is_refused_where_the_primitive_stays_as_it_is(name, value):
    with pytest.raises(ConfigError, match=rf"{name} has no effect on a frozen primitive; got {value}"):
        make_config("ant-gather", "laptop", {"primitive": "ant-walker", name: value})
    learns_on = make_config("ant-gather", "laptop", {"primitive": "ant-walker", "freeze_primitive": False, name: value})
    assert learns_on.values[name] == value
