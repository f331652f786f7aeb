"""Arguments of the vector environment: limits, threads, seeds."""

import re

import gymnasium
import numpy as np
import pytest

import shes  # registers
from shes.errors import ConfigError
from shes.gymnasium.vector_env import TaskVectorEnv

assert shes


def make(num_envs=3, **options):
    return gymnasium.make_vec("shes/PointGather-v0", num_envs=num_envs, **options)


def test_minus_one_takes_the_time_limit_away_as_in_gymnasium():
    for env in (make(max_episode_steps=-1), make(max_episode_steps=-1, vectorization_mode="sync")):
        env.reset(seed=0)
        for _ in range(520):
            _, _, _, truncated, _ = env.step(np.zeros(env.action_space.shape, np.float32))
            assert not truncated.any()


@pytest.mark.parametrize("wrong", [0, -3, 2.5, "a", True])
def test_another_limit_is_a_whole_number_of_at_least_one(wrong):
    with pytest.raises(ConfigError, match=rf"max_episode_steps must be a whole number of at least 1, got {wrong!r}"):
        make(max_episode_steps=wrong)


@pytest.mark.parametrize("wrong", [1.5, "a", True, [1.5, 2, 3], [1, "2", 3], [1, 2, True], {1, 2, 3}, np.array(3.0)])
def test_a_seed_is_a_whole_number_or_a_list(wrong):
    message = rf"seed must be a whole number or a list of them, got {re.escape(repr(wrong))}"
    with pytest.raises(ConfigError, match=message):
        make().reset(seed=wrong)


def test_seeds_may_be_numpys_and_some_may_be_left_open():
    env = make()
    by_number, by_list = env.reset(seed=np.int64(5))[0], env.reset(seed=[5, 6, 7])[0]
    by_array, partly = env.reset(seed=np.array([5, 6, 7]))[0], env.reset(seed=(5, None, 7))[0]
    for other in (by_list, by_array):
        np.testing.assert_array_equal(other, by_number)
    np.testing.assert_array_equal(partly[[0, 2]], by_number[[0, 2]])


def test_threads_change_no_bit():
    envs = [make(num_envs=8, num_threads=threads) for threads in (1, 2, 3)]
    starts = [env.reset(seed=1)[0] for env in envs]
    actions = np.random.default_rng(0).uniform(-1, 1, (50, *envs[0].action_space.shape)).astype(np.float32)
    played = [np.array([env.step(action)[0] for action in actions]) for env in envs]
    for start, observations in zip(starts[1:], played[1:], strict=True):
        np.testing.assert_array_equal(start, starts[0])
        np.testing.assert_array_equal(observations, played[0])


@pytest.mark.parametrize("wrong", [-1, 1.5, "two", None, True])
def test_a_number_of_threads_is_a_whole_number_that_is_not_negative(wrong):
    with pytest.raises(ConfigError, match=rf"num_threads must be a whole number of at least 0, got {wrong!r}"):
        make(num_threads=wrong)


@pytest.mark.parametrize("wrong", [0, -2, 2.5, "two", None, True])
def test_a_number_of_environments_is_a_whole_number_of_at_least_one(wrong):
    with pytest.raises(ConfigError, match=rf"num_envs must be a whole number of at least 1, got {wrong!r}"):
        TaskVectorEnv("point-gather", num_envs=wrong)


def test_there_may_be_more_threads_than_environments():
    assert make(num_envs=2, num_threads=64).reset(seed=0)[0].shape[0] == 2
