"""The contract of tasks, over `ENVIRONMENTS` with every specification, later tasks included.

`view` is everything that a caller can see of a task. Equality is bit-identity. What a task computes is compared with an
independent implementation in `tests/envs/test_task_reference.py`.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.contracts.variants import over_variants
from tests.envs.episodes import FLAGS, NUMBERS, assert_same_view, draw_actions, play, view

pytestmark = over_variants


def start(variant, num_episodes, seeds=None, **options):
    """Return a task after its reset, by default with seeds 0, 1, 2, ..."""
    task = variant.make_task(num_episodes, **options)
    task.reset(np.arange(num_episodes), range(num_episodes) if seeds is None else seeds)
    return task


@pytest.mark.parametrize("evaluation", [False, True])
def test_arrays_have_the_promised_size_and_type(variant, evaluation):
    task = start(variant, 3, evaluation=evaluation)
    for _ in range(2):
        seen = view(task)
        assert_same_view(view(task), seen)  # observing changes nothing
        assert (seen["observation"].shape, seen["observation"].dtype) == ((3, task.observation_size), np.float64)
        assert np.isfinite(seen["observation"]).all()
        for name in NUMBERS + FLAGS:
            assert seen[name].shape == ((3, 2) if name == "position" else (3,)), name
            assert (seen[name].dtype == np.bool_) == (name in FLAGS), name
        assert (np.abs(seen["heading"]) <= np.pi).all()
        assert_array_equal(
            seen["observation"][:, task.proprioception[: task.body.num_qpos]], seen["qpos"][:, : task.body.num_qpos]
        )
        assert_array_equal(seen["observation"][:, task.position_columns], seen["position"])
        play(task, draw_actions(task, 10))


def test_seeds_give_different_episodes_whatever_their_size(variant):
    seeds = [*range(18), np.int64(2**62), 2**100]
    assert len(np.unique(start(variant, 20, seeds).observe(), axis=0)) == 20


def test_an_episode_depends_on_its_seed_and_not_on_the_past(variant):
    used, new = start(variant, 3), start(variant, 3)
    play(used, draw_actions(used, 30, seed=1))
    used.reset(np.array([2, 0, 1]), [2, 0, 1])
    for name in ("time", "reward", "running_return", "terminated", "fallen", "diverged"):
        assert not getattr(used, name).any(), name
    assert_same_view(view(used), view(new))
    for action in draw_actions(used, 20):
        assert_same_view(play(used, [action]), play(new, [action]))


@pytest.mark.parametrize(
    ("num_episodes", "place"),
    [(7, 3), (33, 20), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((2, 1), (8, 7)))],
)
def test_an_episode_does_not_depend_on_the_others(variant, num_episodes, place):
    """The others diverge, begin anew or are not stepped."""
    alone = start(variant, 1, seeds=[77])
    seeds = list(range(num_episodes))
    seeds[place] = 77
    crowd, rng = start(variant, num_episodes, seeds=seeds), np.random.default_rng(4)
    crowd.sim.qvel[place - 1, 0] = 1e12
    others = np.delete(np.arange(num_episodes), [place, (place - 1) % num_episodes])
    for step, action in enumerate(draw_actions(alone, 30)):
        if step % 5 == 2 and len(others):
            crowd.reset(rng.choice(others, 1), [step])
        alone.step(np.arange(1), action[None])
        crowd_actions = rng.uniform(-1, 1, (num_episodes, alone.action_size)) * alone.control_limit
        crowd_actions[place] = action
        resting = rng.choice(others, len(others) // 3, replace=False)
        crowd.step(np.setdiff1d(np.arange(num_episodes), resting), crowd_actions)
        assert_same_view(view(alone), view(crowd, [place]))
    assert_array_equal(np.flatnonzero(crowd.diverged), [(place - 1) % num_episodes])


def test_only_the_episodes_asked_for_are_reset_or_stepped(variant):
    task = start(variant, 5)
    before = play(task, draw_actions(task, 20))
    task.reset(np.array([1, 4]), [100, 101])
    after = view(task)
    for name, values in before.items():
        assert_array_equal(after[name][[0, 2, 3]], values[[0, 2, 3]], err_msg=name)
    assert (after["observation"][[1, 4]] != before["observation"][[1, 4]]).any(axis=1).all()
    for ids in (np.array([1, 2, 4]), np.array([], dtype=np.int64)):
        play(task, draw_actions(task, 3), ids)
    for name in ("qpos", "qvel", "position", "heading"):
        assert_array_equal(view(task)[name][[0, 3]], after[name][[0, 3]], err_msg=name)


def test_actions_may_be_float32_and_are_cut_at_the_limit(variant):
    actions = np.tile(draw_actions(start(variant, 1), 1).astype(np.float32), (2, 1))
    kept, full = actions.copy(), np.full(actions.shape, start(variant, 1).control_limit)

    def seen_after(action):
        task = start(variant, 2)
        task.step(np.arange(2), action)
        return view(task)

    assert_same_view(seen_after(actions), seen_after(actions.astype(np.float64)))
    assert_array_equal(actions, kept)
    assert_same_view(seen_after(full), seen_after(3 * full))
    assert_same_view(seen_after(-full), seen_after(-3 * full))


def test_a_diverged_episode_earns_nothing_and_does_not_score(variant):
    spoiled, calm = start(variant, 3), start(variant, 3)
    actions = draw_actions(calm, 12)
    play(spoiled, actions[:5])
    play(calm, actions[:5])
    spoiled.sim.qvel[1, 0], earned = 1e12, spoiled.running_return[1]
    for action in actions[5:]:
        for task in (spoiled, calm):
            task.step(np.arange(3), np.tile(action, (3, 1)))
        assert_array_equal(spoiled.diverged, [False, True, False])
        assert spoiled.running_return[1] == earned
        shown = [spoiled.reward[1], spoiled.score[1], float(spoiled.success[1])]
        assert [str(each) for each in np.float64(shown)] == ["0.0"] * 3  # "-0.0" looks like a cost
        assert np.isfinite(spoiled.observe()).all()
        assert_same_view(view(spoiled, [0, 2]), view(calm, [0, 2]))
    spoiled.reset(np.arange(3), range(3))
    assert_same_view(view(spoiled), view(start(variant, 3)))
