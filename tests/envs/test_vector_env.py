"""Actions, options, seeds, limits and threads that a user gives to a Gymnasium environment; and copies of it."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest

import shes  # registers
from shes.errors import ConfigError, PolicyError, ShapeError
from shes.gymnasium.vector_env import TaskVectorEnv
from tests.messages import raises

assert shes


def make(num_envs=3, **options):
    return gymnasium.make_vec("shes/PointGather-v0", num_envs=num_envs, **options)


@pytest.fixture(params=[0, 2])
def begin(request):
    """Return a function that returns an environment of the ant, single or of two, that has begun."""

    def make_one(**options):
        name, num_envs = "shes/AntGather-v0", request.param
        made = gymnasium.make_vec(name, num_envs, **options) if num_envs else gymnasium.make(name, **options)
        made.reset(seed=0)
        return made if num_envs else made.unwrapped

    return make_one


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_is_a_new_environment_with_the_same_arguments(begin, duplicate):
    env = begin(reset_noise=0.5)
    other = duplicate(env)
    assert other.task is not env.task
    assert other.task.options == env.task.options
    np.testing.assert_array_equal(other.reset(seed=3)[0], env.reset(seed=3)[0])
    action = np.full(env.action_space.shape, 0.5, np.float32)
    before = env.step(action)[0]
    np.testing.assert_array_equal(other.step(action)[0], before)
    assert (other.step(action)[0] != before).any()
    duplicate(gymnasium.make("shes/PointGather-v0")).reset(seed=1)  # with Gymnasium's wrappers


def test_an_action_may_be_of_any_size_or_a_list(begin):
    action = np.zeros(begin().action_space.shape, int)
    action[..., [1, 3]] = 1, -1
    # Warnings are errors: 1e308 times 30 overflows.
    first, *others = (begin().step(each)[0] for each in (action.astype(float), action.tolist(), action * 1e308))
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_an_action_without_numbers_is_refused(begin):
    env = begin()
    for wrong in ("forward", None, {"leg": 1}, ["1"] * 8, [[0.0], [0.0, 1.0]], np.full(8, 1j)):
        with raises(PolicyError, f"an action must be an array of numbers in [-1, 1], got ... {repr(wrong)[:6]}"):
            env.step(wrong)
    for value in (np.nan, np.inf):
        with raises(PolicyError, "NaN or infinity; actions lie in [-1, 1]"):
            env.step(np.full(env.action_space.shape, value))
    num_envs, size = len(np.atleast_2d(env.action_space.sample())), env.action_space.shape[-1]
    each = f" in each of {num_envs} environments; got (3, {size})" if num_envs > 1 else f"; got ({3 * size},)"
    with raises(ShapeError, f"ant-gather has shape ({size},){each}"):
        env.step(np.zeros((3, size) if num_envs > 1 else 3 * size))


def test_minus_one_takes_the_time_limit_away_as_in_gymnasium():
    env = make(max_episode_steps=-1)
    env.reset(seed=0)
    for _ in range(520):
        assert not env.step(np.zeros(env.action_space.shape, np.float32))[3].any()


SEED = "seed must be a whole number or a list of them, got {}"
LIMIT = "max_episode_steps must be a whole number of at least 1, got {}"
THREADS = "num_threads must be a whole number of at least 0, got {}"
NUMBER = "num_envs must be a whole number of at least 1, got {}"
MODE = "autoreset_mode must be one of NextStep, SameStep, Disabled; got {}"
MASK = "reset_mask must be a Boolean array of shape (3,); got {}"


@pytest.mark.parametrize(
    ("use", "message", "values"),
    [
        (lambda it: make(max_episode_steps=it), LIMIT, (0, -3, 2.5, "a", True)),
        (lambda it: make(num_threads=it), THREADS, (-1, 1.5, "two", None, True)),
        (lambda it: make(autoreset_mode=it), MODE, ("later",)),
        (lambda it: TaskVectorEnv("point-gather", num_envs=it), NUMBER, (0, -2, 2.5, "two", None, True)),
        (lambda it: make().reset(seed=it), SEED, (1.5, "a", True, [1.5, 2, 3], [1, "2", 3], {1, 2, 3}, np.array(3.0))),
        (lambda it: make().reset(seed=it), "must have one for each of 3 environments; got {}", ([1, 2],)),
        (lambda it: make().reset(options={"reset_mask": it}), MASK, (np.ones(2, bool), np.ones(3), [True] * 3)),
        (lambda it: make().reset(options={"reset_mask": it}), "must have at least one True", (np.zeros(3, bool),)),
    ],
)
def test_a_wrong_argument_is_refused(use, message, values):
    for wrong in values:
        with raises(ConfigError, message.format(repr(wrong))):
            use(wrong)


def test_seeds_may_be_numpys_and_some_may_be_left_open():
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((3, 2)))
    by_number, *same = (env.reset(seed=seed)[0] for seed in (np.int64(5), [5, 6, 7], np.array([5, 6, 7])))
    for other in same:
        np.testing.assert_array_equal(other, by_number)
    np.testing.assert_array_equal(env.reset(seed=(5, None, 7))[0][[0, 2]], by_number[[0, 2]])
    followed = [(env.reset(seed=5), env.reset())[1][0] for _ in range(2)]
    np.testing.assert_array_equal(*followed)


def test_threads_change_no_bit():
    envs = [make(num_envs=8, num_threads=threads) for threads in (1, 3, 64)]
    actions = np.random.default_rng(0).uniform(-1, 1, (50, 8, 2)).astype(np.float32)
    played = [np.array([env.reset(seed=1)[0], *(env.step(action)[0] for action in actions)]) for env in envs]
    for other in played[1:]:
        np.testing.assert_array_equal(other, played[0])
