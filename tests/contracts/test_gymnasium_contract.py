"""The Gymnasium contract of every environment and specification, single and vector, made by id."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

import shes  # registers
from shes.envs.gymnasium_ids import MAX_EPISODE_STEPS
from tests.contracts.variants import over_variants

assert shes

NUM_ENVS = 4

pytestmark = over_variants


def draw_actions(env, steps, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


def test_gymnasiums_checker_warns_of_unbounded_spaces_alone(variant):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(variant.make_env().unwrapped, skip_render_check=True)
    assert [str(each.message) for each in caught if "infinity" not in str(each.message)] == []


def test_spaces_are_those_of_the_task(variant):
    env, task = variant.make_env(), variant.make_task(1)
    assert env.observation_space.shape == (task.observation_size,)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (task.action_size,), np.float32)
    assert env.spec.max_episode_steps == MAX_EPISODE_STEPS == 500
    assert len({element.name for element in task.observation_spec}) == task.observation_size


def test_an_episode_is_the_tasks_with_that_seed(variant):
    env, task = variant.make_env(), variant.make_task(1)  # env is checked by Gymnasium: warnings are errors
    task.reset(np.array([0]), [17])
    observation, info = env.reset(seed=17)
    total = 0.0
    for action in draw_actions(env, 40):
        np.testing.assert_array_equal(observation, task.observe()[0])
        observation, reward, terminated, _, info = env.step(action)
        task.step(np.array([0]), np.float64(action)[None] * task.control_limit)
        assert (reward, terminated) == (task.reward[0], task.terminated[0] or task.diverged[0])
        total += reward
        if terminated:
            break
    assert total == pytest.approx(task.running_return[0])
    assert info["score"] == task.score[0]


def test_episodes_without_a_seed_follow_from_the_seed_before(variant):
    env, same, other = variant.make_env(), variant.make_env(), variant.make_env()
    starts = []
    for each, seed in ((env, 1), (same, 1), (other, 2)):
        each.reset(seed=seed)
        starts.append([each.reset()[0] for _ in range(2)])
    np.testing.assert_array_equal(starts[0], starts[1])
    assert (starts[0][0] != starts[0][1]).any()
    assert (np.array(starts[0]) != np.array(starts[2])).any()
    assert len(np.unique(variant.make_vector(NUM_ENVS).reset()[0], axis=0)) == NUM_ENVS  # without any seed they differ


def make_pair(variant, mode, **options):
    """Return the vector environment, and Gymnasium's over single ones."""
    theirs = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": AutoresetMode(mode)}}
    ours = variant.make_vector(NUM_ENVS, autoreset_mode=mode, **options)
    return ours, variant.make_vector(NUM_ENVS, **theirs, **options)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_vector_environment_equals_gymnasiums(variant, mode):
    ours, theirs = make_pair(variant, mode, max_episode_steps=7)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    for space in ("observation_space", "action_space", "single_observation_space", "single_action_space"):
        assert getattr(ours, space) == getattr(theirs, space), space
    assert data_equivalence(ours.reset(seed=11), theirs.reset(seed=11))
    for action in draw_actions(ours, 25):
        assert data_equivalence(ours.step(action), theirs.step(action))


def test_without_autoreset_the_user_resets_who_has_ended(variant):
    ours, theirs = make_pair(variant, "Disabled", max_episode_steps=3)
    assert data_equivalence(ours.reset(seed=1), theirs.reset(seed=1))
    *actions, last = draw_actions(ours, 4)
    for action in actions:
        shown = ours.step(action)
        assert data_equivalence(shown, theirs.step(action))
    assert shown[3].all()
    mask = np.array([True, False, True, True])
    with pytest.raises(gymnasium.error.ResetNeeded):
        ours.step(last)
    shown = [each.reset(options={"reset_mask": mask.copy()}) for each in (ours, theirs)]
    assert data_equivalence(*shown)
    with pytest.raises(gymnasium.error.ResetNeeded):
        ours.step(last)
    shown = [each.reset(seed=4, options={"reset_mask": ~mask}) for each in (ours, theirs)]
    assert data_equivalence(*shown)
    assert data_equivalence(ours.step(last), theirs.step(last))


def test_info_carries_what_a_user_wants_to_know(variant):
    env = variant.make_env()
    _, info = env.reset(seed=0)
    kinds = {"success": bool, "diverged": bool, "score": float, "distance": float, "heading": float}
    kinds |= {"position": np.ndarray, **dict.fromkeys(variant.make_task(1).counts, int)}
    for found in (info, env.step(draw_actions(env, 1)[0])[4]):
        assert {name: type(value) for name, value in found.items()} == kinds
        assert found["position"].shape == (2,)
        assert found["distance"] > 0
        assert not found["diverged"]


def test_what_is_returned_does_not_change_later(variant):
    vector = variant.make_vector(NUM_ENVS)
    observation, info = vector.reset(seed=0)
    first = vector.step(draw_actions(vector, 1)[0])
    before = [observation.copy(), info["position"].copy(), *(part.copy() for part in first[:4])]
    vector.step(draw_actions(vector, 1, seed=1)[0])
    after = [observation, info["position"], *first[:4]]
    for left, right in zip(before, after, strict=True):
        np.testing.assert_array_equal(left, right)


def test_options_reach_the_task_and_divergence_ends_its_episode(variant):
    env = variant.make_env(reset_noise=0.0, integrator="rk4").unwrapped
    env.reset(seed=0)
    assert env.task.options == variant.make_task(1, reset_noise=0.0, integrator="rk4").options
    env.task.sim.qvel[0, 0] = 1e12
    _, reward, terminated, _, info = env.step(np.zeros(env.action_space.shape))
    assert (reward, terminated, info["diverged"], info["score"], info["success"]) == (0, True, True, 0, False)
