"""Golden trajectories: what an environment did when its numbers were last changed on purpose, it still does."""

import mujoco
import numpy as np
import pytest

from tests.contracts.variants import VARIANTS
from tests.golden import trajectories

TOLERANCE = 1e-6
"""Another processor rounds differently, and contacts let that grow; within two seconds it stays far below this."""

over_all = pytest.mark.parametrize("variant", VARIANTS, ids=trajectories.title)


def advice(variant, stored):
    """Return what to do about a difference."""
    name, regenerate = trajectories.title(variant), "`python -m tests.golden.trajectories`"
    if stored["mujoco"] != mujoco.__version__:
        return (
            f"{name} moves differently with MuJoCo {mujoco.__version__} than with {stored['mujoco']}, of which its "
            "golden trajectory is. Read MuJoCo's changelog for the reason. Check with `make test-all` that walls and "
            "blocks still hold (tests/envs/test_physics.py) and that scripts still solve the tasks "
            f"(tests/envs/test_scripted_point.py). If it is acceptable, run {regenerate}, pin the version in "
            "constraints.txt, and write 'changes numbers' into CHANGELOG.md: results of the two versions do not "
            "compare."
        )
    return (
        f"{name} no longer moves as its golden trajectory says, with the same MuJoCo {mujoco.__version__}: the task "
        f"itself has changed. If that was not meant, undo it; if it was, run {regenerate} and write 'changes numbers' "
        "into CHANGELOG.md."
    )


@over_all
def test_an_environment_moves_as_its_golden_trajectory_says(variant):
    assert trajectories.golden_file(variant).exists(), "no golden trajectory: run `python -m tests.golden.trajectories`"
    stored, played = trajectories.load(variant), trajectories.play(variant)
    message = advice(variant, stored)
    assert played["seeds"] == stored["seeds"], message
    for key in ("observations", "rewards", "scores"):
        np.testing.assert_allclose(played[key], stored[key], rtol=0, atol=TOLERANCE, err_msg=message)


@over_all
def test_rounding_stays_far_below_the_tolerance_of_the_golden_trajectory(variant):
    exact, shifted = (np.array(trajectories.play(variant, shift)["observations"]) for shift in (0.0, 1e-12))
    assert np.abs(exact - shifted).max() < TOLERANCE / 100


@over_all
def test_a_change_of_a_thousandth_is_seen_by_the_golden_trajectory(variant):
    exact, shifted = (np.array(trajectories.play(variant, shift)["observations"]) for shift in (0.0, 1e-3))
    assert np.abs(exact - shifted)[:, 1:].max() > 10 * TOLERANCE


def test_every_golden_trajectory_belongs_to_an_environment():
    stored = set(trajectories.FOLDER.glob("trajectory_*.json"))
    assert stored == {trajectories.golden_file(variant) for variant in VARIANTS}


@pytest.mark.parametrize("of_version", [mujoco.__version__, "0.0.1"], ids=["same", "another"])
def test_a_difference_fails_with_advice(monkeypatch, of_version):
    variant = VARIANTS[0]
    stored = trajectories.load(variant) | {"mujoco": of_version}
    stored["rewards"][1][-1] += 10 * TOLERANCE
    monkeypatch.setattr(trajectories, "load", lambda _: stored)
    with pytest.raises(AssertionError) as caught:
        test_an_environment_moves_as_its_golden_trajectory_says(variant)
    message = str(caught.value)
    for told in ("`python -m tests.golden.trajectories`", "write 'changes numbers' into CHANGELOG.md"):
        assert told in message
    assert ("the task itself has changed" in message) == (of_version == mujoco.__version__)
    another = ("than with 0.0.1", "MuJoCo's changelog", "test_physics.py", "test_scripted_point.py", "constraints.txt")
    for told in another:
        assert (told in message) == (of_version != mujoco.__version__), told


def test_golden_trajectories_collect_something():
    """Otherwise they would not see a change of Gather's rewards."""
    assert any(np.any(trajectories.load(each)["rewards"]) for each in VARIANTS if each.name.endswith("-gather"))


@pytest.mark.parametrize("kind", ["maze", "push", "fall"])
def test_golden_trajectories_hit_what_is_in_the_way(kind):
    """Otherwise they would not see a change of the contacts with walls and blocks."""
    for variant in VARIANTS:
        if not variant.name.endswith(kind):
            continue
        task = variant.make_task(1)
        ways = np.array(trajectories.load(variant)["observations"])[:, :, 1]
        assert (ways.max(axis=1) > 3).all()  # they fly at what is 4 m away
        if "block_y" in (places := [element.name for element in task.observation_spec]):
            moved = np.array(trajectories.load(variant)["observations"])[:, -1, places.index("block_y")]
            assert (moved > 0.01).any(), variant
