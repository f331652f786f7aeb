"""Golden trajectories: what an environment did when its numbers were last changed on purpose, it still does."""

import mujoco
import numpy as np
import pytest

from shes.envs.registry import ENVIRONMENTS
from tests.golden import trajectories

TOLERANCE = 1e-6
"""Another processor rounds differently, and contacts let that grow; within two seconds it stays far below this."""


def advice(name, stored):
    """Return what to do about a difference."""
    regenerate = "`python -m tests.golden.trajectories`"
    if stored["mujoco"] != mujoco.__version__:
        return (
            f"{name} moves differently with MuJoCo {mujoco.__version__} than with {stored['mujoco']}, of which its "
            "golden trajectory is. Read MuJoCo's changelog for the reason. If it is acceptable, run "
            f"{regenerate}, pin the version in constraints.txt, and write 'changes numbers' into CHANGELOG.md: results "
            "of the two versions do not compare."
        )
    return (
        f"{name} no longer moves as its golden trajectory says, with the same MuJoCo {mujoco.__version__}: the task "
        f"itself has changed. If that was not meant, undo it; if it was, run {regenerate} and write 'changes numbers' "
        "into CHANGELOG.md."
    )


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_environment_moves_as_its_golden_trajectory_says(name):
    assert trajectories.golden_file(name).exists(), "no golden trajectory: run `python -m tests.golden.trajectories`"
    stored, played = trajectories.load(name), trajectories.play(name)
    message = advice(name, stored)
    assert played["seeds"] == stored["seeds"], message
    for key in ("observations", "rewards", "scores"):
        np.testing.assert_allclose(played[key], stored[key], rtol=0, atol=TOLERANCE, err_msg=message)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_rounding_stays_far_below_the_tolerance_of_the_golden_trajectory(name):
    exact, shifted = (np.array(trajectories.play(name, shift)["observations"]) for shift in (0.0, 1e-12))
    assert np.abs(exact - shifted).max() < TOLERANCE / 100


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_change_of_a_thousandth_is_seen_by_the_golden_trajectory(name):
    exact, shifted = (np.array(trajectories.play(name, shift)["observations"]) for shift in (0.0, 1e-3))
    assert np.abs(exact - shifted)[:, 1:].max() > 10 * TOLERANCE


def test_every_golden_trajectory_belongs_to_an_environment():
    stored = set(trajectories.FOLDER.glob("trajectory_*.json"))
    assert stored == {trajectories.golden_file(name) for name in ENVIRONMENTS}


def test_the_advice_tells_a_new_mujoco_from_a_changed_task():
    same, other = {"mujoco": mujoco.__version__}, {"mujoco": "0.0.1"}
    assert "the task itself has changed" in advice("ant-gather", same)
    assert "than with 0.0.1" in advice("ant-gather", other)
    for stored in (same, other):
        assert "python -m tests.golden.trajectories" in advice("ant-gather", stored)


def test_golden_trajectories_collect_something():
    """Otherwise they would not see a change of the rewards."""
    assert any(np.any(trajectories.load(name)["rewards"]) for name in ENVIRONMENTS if name.endswith("-gather"))
