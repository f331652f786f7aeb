"""Short scripts solve the point's tasks, so the worlds are as intended.

A script is a list of waypoints: x, y, and for a waypoint that may be out of reach the number of steps after which the
point continues with the next.
"""

import numpy as np
import pytest

from tests.envs.episodes import make_task

PUSH_OVER = [(8, 0), (8, 13, 60)]
"""The last place is in the block, which the far platform holds: the point presses it against that for a while."""
SOLUTIONS = {
    "point-maze": ([(15, 0), (16, 14), (3, 16)], 50, 80),
    "point-push": ([(-8, 0), (-8, 8), (0, 8), (-2, 8), (-2, 16)], 91, 140),
    "point-fall": ([*PUSH_OVER, (8, 9), (8, 24), (0, 26)], 101, 220),
}
"""Scripts that solve a task, and the fewest and most steps that they take."""
NUM_EPISODES = 5


@pytest.mark.parametrize("spec", ["shes", "hiro"])
@pytest.mark.parametrize("name", SOLUTIONS)
def test_a_script_solves_the_task(name, spec):
    script, fewest, most = SOLUTIONS[name]
    task, ids = make_task(name, NUM_EPISODES, evaluation=True, spec=spec), np.arange(NUM_EPISODES)
    task.reset(ids, ids)
    places = np.array([place[:2] for place in script], dtype=float)
    patience = np.array([place[2] if len(place) > 2 else 10_000 for place in script])
    current, begun, solved_at = (np.zeros(NUM_EPISODES, dtype=int) for _ in range(3))
    for step in range(1, most + 1):
        # Less thrust near the place, and damped.
        thrust = 1.5 * (places[current] - task.position) - 0.3 * task.sim.qvel[:, :2]
        task.step(ids, np.clip(thrust, -1, 1) * task.control_limit)
        is_there = np.linalg.norm(places[current] - task.position, axis=1) < 0.6
        goes_on = (is_there | (step - begun >= patience[current])) & (current < len(places) - 1)
        current, begun = current + goes_on, np.where(goes_on, step, begun)
        solved_at[task.success & (solved_at == 0)] = step
    assert not task.diverged.any()
    assert fewest <= solved_at.min() <= solved_at.max() <= most
    assert task.score.tolist() == [1] * NUM_EPISODES
    first, second = task.sim.qpos[:, -2:].T  # of the block
    if name == "point-push":
        assert ((first > 2.5) & (np.abs(second) < 0.1)).all()
    if name == "point-fall":  # the block is at the bottom of the chasm, its top level with the platforms
        assert (np.abs([task.sim.qpos[:, 2] - 4.25, first - 8, second + 4]) < 0.1).all()
