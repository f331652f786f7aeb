"""What an action in Gymnasium may be: numbers, of any size; what is no number is refused before the physics see it."""

import re

import gymnasium
import numpy as np
import pytest

import shes  # registers
from shes.errors import PolicyError

assert shes

ID = "shes/AntGather-v0"


def make(num_envs):
    """Return an environment, single if `num_envs` is 0, that has begun."""
    env = gymnasium.make_vec(ID, num_envs=num_envs) if num_envs else gymnasium.make(ID).unwrapped
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("num_envs", [0, 2])
def test_a_finite_action_of_any_size_is_the_strongest(num_envs):
    shown = []
    for size in (1.0, 1e308):  # warnings are errors: 1e308 times 30 overflows
        env = make(num_envs)
        shown.append(env.step(np.full(env.action_space.shape, -size))[0])
    np.testing.assert_array_equal(*shown)


@pytest.mark.parametrize("num_envs", [0, 2])
@pytest.mark.parametrize("wrong", ["forward", None, {"leg": 1}, ["1"] * 8, [[0.0], [0.0, 1.0]], np.full(8, 1j)])
def test_an_action_without_numbers_is_refused(num_envs, wrong):
    with pytest.raises(PolicyError, match=r"an action must be an array of numbers in \[-1, 1\], got .*") as caught:
        make(num_envs).step(wrong)
    assert re.search(re.escape(repr(wrong)[:6]), str(caught.value))


def test_whole_numbers_and_lists_are_actions_too():
    one, other = make(0), make(0)
    np.testing.assert_array_equal(one.step([0, 1, 0, -1, 0, 0, 0, 0])[0], other.step(np.eye(8)[1] - np.eye(8)[3])[0])
