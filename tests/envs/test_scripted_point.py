"""Short scripts solve the point's tasks, and wrong scripts do not, so the worlds are as intended.

A script is a list of waypoints: x, y, and for a waypoint that may be out of reach the number of steps after which the
point continues with the next.
"""

import numpy as np
import pytest

from shes.envs.registry import find_environment, make_task
from shes.envs.worlds import INTEGRATORS

NEVER = 10_000
THROUGH_THE_MAZE = [(15, 0), (16, 14), (3, 16)]
STRAIGHT_AT_THE_MAZES_TARGET = [(0, 16)]
ROUND_THE_BLOCK = [(-8, 0), (-8, 8)]
PUSH_ASIDE = [*ROUND_THE_BLOCK, (0, 8), (-2, 8), (-2, 16)]
PUSH_AHEAD = [(0, 19)]
INTO_THE_CHASM = [(0, 24)]
PUSH = [(8, 0), (8, 13, 60)]
"""The last place is in the block, which the far platform holds: the point presses it against that for a while."""
PUSH_AND_CROSS = [*PUSH, (8, 9), (8, 24), (0, 26)]
KEEP_PUSHING = [(8, 0), (8, 24), (0, 26)]

NUM_EPISODES = 5
REACHED_M = 0.6
"""A place is reached when it is nearer."""


def steer(task, places):
    """Return thrust towards `places` [N, 2]: less near them, and damped [N, A]."""
    return np.clip(1.5 * (places - task.position) - 0.3 * task.sim.qvel[:, :2], -1, 1) * task.control_limit


def follow(name, script, steps, **options):
    """Follow `script` in five episodes; return the task and the step of each episode's first success (0: none)."""
    task = make_task(name, NUM_EPISODES, find_environment(name).options(evaluation=True, **options))
    ids = np.arange(NUM_EPISODES)
    task.reset(ids, ids)
    places = np.array([place[:2] for place in script], dtype=float)
    patience = np.array([place[2] if len(place) > 2 else NEVER for place in script])
    current, begun, solved_at = (np.zeros(NUM_EPISODES, dtype=int) for _ in range(3))
    for step in range(1, steps + 1):
        task.step(ids, steer(task, places[current]))
        is_there = np.linalg.norm(places[current] - task.position, axis=1) < REACHED_M
        goes_on = (is_there | (step - begun >= patience[current])) & (current < len(places) - 1)
        current, begun = current + goes_on, np.where(goes_on, step, begun)
        solved_at[task.success & (solved_at == 0)] = step
    assert not task.diverged.any()
    return task, solved_at


@pytest.mark.parametrize("spec", ["shes", "hiro"])
@pytest.mark.parametrize(
    ("name", "script", "fewest", "most"),
    [
        ("point-maze", THROUGH_THE_MAZE, 50, 80),
        ("point-push", PUSH_ASIDE, 91, 140),
        ("point-fall", PUSH_AND_CROSS, 101, 220),
    ],
)
def test_a_script_solves_the_task(name, script, fewest, most, spec):
    task, solved_at = follow(name, script, most, spec=spec)
    assert fewest <= solved_at.min()
    assert solved_at.max() <= most
    assert task.score.tolist() == [1] * NUM_EPISODES
    first, second = task.sim.qpos[:, -2:].T  # of the block
    if name == "point-push":
        assert (first > 2.5).all()
        assert (np.abs(second) < 0.1).all()
    if name == "point-fall":
        assert (np.abs(task.sim.qpos[:, 2] - 4.25) < 0.1).all()
        assert (np.abs(first - 8) < 0.1).all()
        assert (np.abs(second + 4) < 0.1).all()  # at the bottom of the chasm, its top level with the platforms


def test_the_straight_way_to_the_mazes_target_ends_at_the_wall():
    task, solved_at = follow("point-maze", STRAIGHT_AT_THE_MAZES_TARGET, 100)
    assert not solved_at.any()
    np.testing.assert_allclose(task.position, np.tile([0, 3.8], (NUM_EPISODES, 1)), atol=0.1)


def test_a_block_that_is_pushed_ahead_closes_the_passage():
    task, solved_at = follow("point-push", PUSH_AHEAD, 300)
    assert not solved_at.any()
    block_x, block_y = task.sim.qpos[:, 2:].T
    assert (np.abs(block_x) < 0.1).all()
    assert (np.abs(block_y - 8) < 0.2).all()  # in the passage, against the wall behind it


def test_without_the_block_the_point_falls_into_the_chasm():
    task, solved_at = follow("point-fall", INTO_THE_CHASM, 200)
    assert not solved_at.any()
    _, y, z, *block = task.sim.qpos.T
    assert (z < 3).all()
    assert ((y > 12) & (y < 20)).all()
    assert np.abs(block).max() < 0.05


def test_pressing_holds_the_block_over_the_chasm():
    """The block is so light that friction with the platform's edge carries it: releasing it is part of the task."""
    task, solved_at = follow("point-fall", KEEP_PUSHING, 300)
    assert not solved_at.any()
    assert (np.abs(task.sim.qpos[:, 3] - 8) < 0.1).all()
    assert (task.sim.qpos[:, 4] > -0.5).all()


@pytest.mark.slow
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(
    ("name", "script", "steps"),
    [("point-maze", THROUGH_THE_MAZE, 80), ("point-push", PUSH_ASIDE, 140), ("point-fall", PUSH_AND_CROSS, 220)],
)
def test_scripts_solve_tasks_with_every_integrator(name, script, steps, integrator):
    assert follow(name, script, steps, integrator=integrator)[0].success.all()
