"""The contract of tasks, over `shes.envs.registry.ENVIRONMENTS` with every specification, later tasks included.

`view` is everything that a caller can see of a task. Equality is bit-identity.
"""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.registry import ENVIRONMENTS
from shes.envs.tasks.task import VELOCITY_CLIP
from shes.envs.worlds import INTEGRATORS
from tests.contracts.variants import over_variants

pytestmark = over_variants

SHOWN = (
    "time",
    "reward",
    "running_return",
    "score",
    "success",
    "terminated",
    "fallen",
    "diverged",
    "position",
    "heading",
)


def view(task, rows=slice(None)):
    """Return copies of every array of `rows`, by name."""
    seen = {name: np.array(getattr(task, name)[rows]) for name in SHOWN}
    seen["observation"] = task.observe()[rows].copy()
    seen["qpos"], seen["qvel"] = task.sim.qpos[rows].copy(), task.sim.qvel[rows].copy()
    return seen


def assert_same_view(left, right):
    for name, values in left.items():
        assert_array_equal(values, right[name], err_msg=name)


def start(variant, num_episodes, seeds=None, **options):
    """Return a task after its reset, by default with seeds 0, 1, 2, ..."""
    task = variant.make_task(num_episodes, **options)
    task.reset(np.arange(num_episodes), range(num_episodes) if seeds is None else seeds)
    return task


def draw_actions(task, steps, seed=0):
    """Return actions [steps, A] that use the whole range of the controls."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, task.action_size)) * task.control_limit


def play(task, actions, ids=None):
    """Step with `actions` [steps, A], the same for every row, and return the view after each step."""
    views = []
    for action in actions:
        task.step(np.arange(task.num_episodes) if ids is None else ids, np.tile(action, (task.num_episodes, 1)))
        views.append(view(task))
    return views


def test_the_observation_is_finite_float64_of_the_promised_size(variant):
    task = start(variant, 3)
    for action in [None, *draw_actions(task, 10)]:
        if action is not None:
            task.step(np.arange(3), np.tile(action, (3, 1)))
        observation = task.observe()
        assert observation.shape == (3, task.observation_size)
        assert observation.dtype == np.float64
        assert np.isfinite(observation).all()


def test_observing_changes_nothing(variant):
    task = start(variant, 2)
    play(task, draw_actions(task, 3))
    before = view(task)
    for _ in range(3):
        task.observe()
    assert_same_view(view(task), before)


def test_what_is_shown_has_one_row_per_episode(variant):
    task = start(variant, 3)
    play(task, draw_actions(task, 3))
    for attribute in SHOWN:
        expected = (3, 2) if attribute == "position" else (3,)
        assert np.shape(getattr(task, attribute)) == expected, attribute
    for attribute in ("success", "terminated", "fallen", "diverged"):
        assert getattr(task, attribute).dtype == np.bool_, attribute
    assert (np.abs(task.heading) <= np.pi).all()


def test_a_fresh_episode_has_neither_time_nor_reward_nor_end(variant):
    task = start(variant, 2)
    play(task, draw_actions(task, 5))
    task.reset(np.arange(2), [8, 9])
    for attribute in ("time", "reward", "running_return", "terminated", "fallen", "diverged"):
        assert not getattr(task, attribute).any(), attribute


def test_the_same_seed_gives_the_same_episode(variant):
    one, other = start(variant, 3), start(variant, 3)
    assert_same_view(view(one), view(other))
    actions = draw_actions(one, 20)
    for left, right in zip(play(one, actions), play(other, actions), strict=True):
        assert_same_view(left, right)


def test_different_seeds_give_different_episodes(variant):
    observations = start(variant, 20).observe()
    assert len(np.unique(observations, axis=0)) == 20


def test_a_seed_may_be_any_non_negative_integer(variant):
    task = start(variant, 3, seeds=[0, np.int64(2**62), 2**100])
    assert len(np.unique(task.observe(), axis=0)) == 3


def test_an_episode_begins_the_same_whatever_the_object_did_before(variant):
    used, new = start(variant, 3), start(variant, 3)
    actions = draw_actions(used, 20)
    play(used, draw_actions(used, 30, seed=1))
    used.reset(np.arange(3), range(3))
    assert_same_view(view(used), view(new))
    for left, right in zip(play(used, actions), play(new, actions), strict=True):
        assert_same_view(left, right)


@pytest.mark.parametrize(
    ("num_episodes", "place"),
    [
        pytest.param(2, 1, marks=pytest.mark.slow),
        pytest.param(7, 0, marks=pytest.mark.slow),
        (7, 3),
        pytest.param(8, 7, marks=pytest.mark.slow),
        (33, 20),
    ],
)
def test_an_episode_depends_neither_on_the_batch_nor_on_its_place_in_it(variant, num_episodes, place):
    alone = start(variant, 1, seeds=[77])
    seeds = list(range(num_episodes))
    seeds[place] = 77
    crowd = start(variant, num_episodes, seeds=seeds)
    crowd.sim.qvel[place - 1, 0] = 1e12  # a neighbour that blows up
    rng = np.random.default_rng(4)
    for action in draw_actions(alone, 30):
        alone.step(np.arange(1), action[None])
        crowd_actions = rng.uniform(-1, 1, (num_episodes, alone.action_size)) * alone.control_limit
        crowd_actions[place] = action
        crowd.step(np.arange(num_episodes), crowd_actions)
        assert_same_view(view(alone), view(crowd, [place]))
    assert_array_equal(np.flatnonzero(crowd.diverged), [(place - 1) % num_episodes])


def test_the_order_of_a_reset_does_not_matter(variant):
    one, other = start(variant, 4), start(variant, 4)
    other.reset(np.array([3, 0, 2, 1]), [3, 0, 2, 1])
    assert_same_view(view(one), view(other))


def test_a_reset_leaves_the_other_episodes_alone(variant):
    task = start(variant, 5)
    play(task, draw_actions(task, 20))
    before = view(task)
    task.reset(np.array([1, 4]), [100, 101])
    after = view(task)
    for key, values in before.items():
        assert_array_equal(after[key][[0, 2, 3]], values[[0, 2, 3]], err_msg=key)
    assert not after["time"][[1, 4]].any()
    assert (after["observation"][[1, 4]] != before["observation"][[1, 4]]).any(axis=1).all()


def test_an_episode_does_not_notice_that_others_are_reset(variant):
    disturbed, calm = start(variant, 4), start(variant, 4)
    for step, action in enumerate(draw_actions(calm, 20)):
        if step % 5 == 2:
            disturbed.reset(np.array([0, 3]), [step, step + 50])
        for task in (disturbed, calm):
            task.step(np.arange(4), np.tile(action, (4, 1)))
        assert_same_view(view(disturbed, [1, 2]), view(calm, [1, 2]))


def test_without_reset_noise_an_episode_begins_in_the_default_pose_at_rest(variant):
    task = start(variant, 3, reset_noise=0.0)
    play(task, draw_actions(task, 10))
    task.reset(np.array([0, 2]), [5, 6])
    assert_array_equal(task.sim.qpos[[0, 2]], np.tile(task.sim.model.qpos0, (2, 1)))
    assert not task.sim.qvel[[0, 2]].any()


@pytest.mark.parametrize("noise", [0.1, 0.02])
def test_reset_noise_is_uniform_on_the_pose_and_normal_on_the_velocity(variant, noise):
    num_episodes = 300
    task = start(variant, num_episodes, reset_noise=noise)
    body, default = task.body, task.sim.model.qpos0
    shift = task.sim.qpos[:, : body.num_qpos] - default[: body.num_qpos]
    plain = np.ones(body.num_qpos, dtype=bool)
    if body.quaternion is not None:
        plain[body.quaternion] = False
        quaternion = task.sim.qpos[:, body.quaternion]
        np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1, atol=1e-12)
        turn = np.abs(quaternion[:, 1:] / quaternion[:, :1])
        assert turn.max() <= noise / (1 - noise)
        assert turn.max(axis=0).min() > 0.9 * noise
    shift = shift[:, plain]
    assert np.abs(shift).max() <= noise
    assert shift.max(axis=0).min() > 0.9 * noise
    assert shift.min(axis=0).max() < -0.9 * noise
    np.testing.assert_allclose(shift.std(axis=0), noise / np.sqrt(3), rtol=0.12)
    velocity = task.sim.qvel[:, : body.num_qvel]
    np.testing.assert_allclose(velocity.std(axis=0), noise, rtol=0.2)
    assert np.abs(velocity).max() > 2 * noise
    assert np.abs(np.corrcoef(np.hstack([shift, velocity]).T) - np.eye(shift.shape[1] + body.num_qvel)).max() < 0.3


def test_what_is_not_the_robot_begins_exactly_in_place(variant):
    task = start(variant, 5)
    body = task.body
    assert_array_equal(task.sim.qpos[:, body.num_qpos :], np.tile(task.sim.model.qpos0[body.num_qpos :], (5, 1)))
    assert not task.sim.qvel[:, body.num_qvel :].any()


def test_episodes_that_are_not_stepped_do_not_move(variant):
    part, whole = start(variant, 5), start(variant, 5)
    before = view(part)
    ids = np.array([1, 2, 4])
    for action in draw_actions(part, 10):
        part.step(ids, np.tile(action, (5, 1)))
        whole.step(np.arange(5), np.tile(action, (5, 1)))
        assert_same_view(view(part, ids), view(whole, ids))
    after = view(part)
    for key in ("qpos", "qvel", "position", "heading"):
        assert_array_equal(after[key][[0, 3]], before[key][[0, 3]], err_msg=key)


def test_an_episode_that_waited_can_be_reset_and_stepped(variant):
    task, new = start(variant, 3), start(variant, 3)
    actions = draw_actions(task, 10)
    play(task, actions, ids=np.array([0]))
    task.reset(np.arange(3), range(3))
    for left, right in zip(play(task, actions), play(new, actions), strict=True):
        assert_same_view(left, right)


def test_stepping_no_episode_moves_none(variant):
    task = start(variant, 2)
    before = view(task)
    task.step(np.array([], dtype=np.int64), np.zeros((2, task.action_size)))
    assert_array_equal(task.sim.qpos, before["qpos"])
    assert_array_equal(task.sim.qvel, before["qvel"])


def test_the_callers_actions_are_not_changed(variant):
    task = start(variant, 2)
    actions = np.tile(draw_actions(task, 1), (2, 1))
    before = actions.copy()
    task.step(np.arange(2), actions)
    assert_array_equal(actions, before)


def test_actions_may_be_float32(variant):
    task, same = start(variant, 2), start(variant, 2)
    actions = np.tile(draw_actions(task, 1).astype(np.float32), (2, 1))
    task.step(np.arange(2), actions)
    same.step(np.arange(2), actions.astype(np.float64))
    assert_same_view(view(task), view(same))


def test_actions_at_the_limit_are_the_strongest(variant):
    limit = start(variant, 1).control_limit
    for sign in (-1, 1):
        task, beyond = start(variant, 1), start(variant, 1)
        for each, factor in ((task, 1.0), (beyond, 3.0)):
            each.step(np.arange(1), np.full((1, each.action_size), sign * factor * limit))
        assert_array_equal(task.sim.qvel, beyond.sim.qvel)


def test_a_diverged_episode_earns_nothing_and_does_not_score(variant):
    spoiled, calm = start(variant, 3), start(variant, 3)
    actions = draw_actions(calm, 12)
    play(spoiled, actions[:5])
    play(calm, actions[:5])
    spoiled.sim.qvel[1, 0] = 1e12
    for action in actions[5:]:
        for task in (spoiled, calm):
            task.step(np.arange(3), np.tile(action, (3, 1)))
        assert_array_equal(spoiled.diverged, [False, True, False])
        assert spoiled.reward[1] == 0
        assert spoiled.score[1] == 0
        assert not np.signbit([spoiled.reward[1], spoiled.score[1]]).any()  # "-0.0" looks like a cost
        assert not spoiled.success[1]
        assert np.isfinite(spoiled.observe()).all()
        assert_same_view(view(spoiled, [0, 2]), view(calm, [0, 2]))


def test_a_diverged_episode_earns_nothing_whatever_the_task_pays(variant):
    body, kind = ENVIRONMENTS[variant.name]
    generous = type("Generous", (kind,), {"update_features": lambda self: np.ones(self.num_episodes)})
    task = generous(body(), 3, variant.options())
    task.reset(np.arange(3), range(3))
    task.sim.qvel[1, 0] = 1e12
    for _ in range(2):
        task.step(np.arange(3), np.zeros((3, task.action_size)))
        assert_array_equal(task.reward, [1, 0, 1])
    assert_array_equal(task.running_return, [2, 0, 2])


def test_a_reset_makes_a_diverged_episode_whole_again(variant):
    task, new = start(variant, 2), start(variant, 2)
    actions = draw_actions(task, 10)
    for _ in range(2):
        task.sim.qvel[1, 0] = 1e12
        play(task, actions[:2])
        assert_array_equal(task.diverged, [False, True])
        task.reset(np.arange(2), range(2))
    for left, right in zip(play(task, actions), play(new, actions), strict=True):
        assert_same_view(left, right)


def test_proprioception_is_the_robots_pose_and_its_velocity_which_shes_clips(variant):
    task = start(variant, 3)
    body = task.body
    task.sim.qvel[0, : body.num_qvel] = 20.0
    task.sim.qvel[1, : body.num_qvel] = -20.0
    task.step(np.arange(3), np.tile(draw_actions(task, 1), (3, 1)))
    qpos, qvel = task.sim.qpos[:, : body.num_qpos], task.sim.qvel[:, : body.num_qvel]
    assert np.abs(qvel).max() > VELOCITY_CLIP
    indices = task.proprioception
    assert indices.shape == (body.num_qpos + body.num_qvel,)
    assert np.issubdtype(indices.dtype, np.integer)
    own = task.observe()[:, indices]
    assert_array_equal(own[:, : body.num_qpos], qpos)
    assert_array_equal(own[:, body.num_qpos :], np.clip(qvel, -10, 10) if variant.spec == "shes" else qvel)


def test_position_is_where_the_robots_torso_is(variant):
    task = start(variant, 3)
    play(task, draw_actions(task, 10))
    torso = task.sim.model.body("torso").id
    data = mujoco.MjData(task.sim.model)
    for i in range(3):
        data.qpos[:] = task.sim.qpos[i]
        mujoco.mj_kinematics(task.sim.model, data)
        np.testing.assert_allclose(task.position[i], data.xpos[torso, :2], atol=1e-12)


def test_the_running_return_is_the_sum_of_the_rewards(variant):
    task = start(variant, 4)
    views = play(task, draw_actions(task, 60))
    total = np.sum([seen["reward"] for seen in views], axis=0)
    np.testing.assert_allclose(task.running_return, total, rtol=1e-12, atol=1e-12)


def test_a_task_knows_no_time_limit(variant):
    task = start(variant, 1, reset_noise=0.0)
    still = np.zeros((1, task.action_size))
    for step in range(520):
        task.step(np.arange(1), still)
        assert not task.terminated.any(), step
    assert task.time[0] == 520
    before = task.observe().copy()
    task.step(np.arange(1), np.full((1, task.action_size), task.control_limit))
    assert (task.observe() != before).any()


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_every_integrator_steps(variant, integrator):
    task = start(variant, 3, integrator=integrator)
    assert task.sim.model.opt.integrator == INTEGRATORS[integrator]
    before = task.position.copy()
    play(task, draw_actions(task, 30))
    assert np.isfinite(task.observe()).all()
    assert not task.diverged.any()
    assert (task.position != before).all()


def test_integrators_differ(variant):
    euler, rk4 = start(variant, 5, integrator="euler"), start(variant, 5, integrator="rk4")
    assert_same_view(view(euler), view(rk4))
    actions = draw_actions(euler, 5)
    # In the first tenth of a second nothing touches the ground. Contacts let the difference grow: an ant that is thrown
    # about by full actions is 0.1 to 0.3 m elsewhere after half a second.
    play(euler, actions[:1])
    play(rk4, actions[:1])
    np.testing.assert_allclose(euler.position, rk4.position, rtol=0, atol=0.01)
    play(euler, actions[1:])
    play(rk4, actions[1:])
    assert (euler.sim.qpos != rk4.sim.qpos).any(axis=1).all()


def test_a_control_step_is_a_tenth_of_a_second(variant):
    task = start(variant, 1)
    model = task.sim.model
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = task.sim.qpos[0], task.sim.qvel[0]
    action = draw_actions(task, 1)
    data.ctrl[:] = action[0]
    while data.time < 0.1 - 1e-9:
        mujoco.mj_step(model, data)
    task.step(np.arange(1), action)
    assert_array_equal(task.sim.qpos[0], data.qpos)
    assert data.time == pytest.approx(0.1)


def test_a_task_of_evaluation_has_the_same_observation(variant):
    task = start(variant, 2, evaluation=True)
    assert task.observe().shape == start(variant, 2).observe().shape
    play(task, draw_actions(task, 3))
    assert np.isfinite(task.observe()).all()
