"""Golden trajectories: what an environment did when its numbers were last changed on purpose, it still does."""

import numpy as np
import pytest

from tests.contracts.variants import VARIANTS
from tests.golden import trajectories

TOLERANCE = 1e-6
"""Another processor rounds differently, and contacts let that grow; within two seconds it stays far below this."""


WHAT_TO_DO = (
    "{name} moves otherwise than its golden trajectory says, which is of MuJoCo {version}. With the same version, the"
    " task has changed: if that was not meant, undo it. With another one, read its changelog and check with `make"
    " test-all` that walls hold and scripts solve the tasks. To go on, run `python -m tests.golden.trajectories`, pin"
    " the version in constraints.txt, and write 'changes numbers' into CHANGELOG.md."
)


@pytest.mark.parametrize("variant", VARIANTS, ids=trajectories.title)
def test_an_environment_moves_as_its_golden_trajectory_says(variant):
    assert trajectories.golden_file(variant).exists(), "no golden trajectory: run `python -m tests.golden.trajectories`"
    stored, played = trajectories.load(variant), trajectories.play(variant)
    message = WHAT_TO_DO.format(name=trajectories.title(variant), version=stored["mujoco"])
    assert played["seeds"] == stored["seeds"], message
    for key in ("observations", "rewards", "scores"):
        np.testing.assert_allclose(played[key], stored[key], rtol=0, atol=TOLERANCE, err_msg=message)
    exact, *others = (np.array(each["observations"]) for each in (
        played, *(trajectories.play(variant, shift) for shift in (1e-12, 1e-3))
    ))  # fmt: skip
    rounding, thousandth = (np.abs(exact - other)[:, 1:].max() for other in others)
    assert rounding < TOLERANCE / 100 < 10 * TOLERANCE < thousandth  # it is seen, and rounding is not


def test_every_golden_trajectory_belongs_to_an_environment():
    stored = set(trajectories.FOLDER.glob("trajectory_*.json"))
    assert stored == {trajectories.golden_file(variant) for variant in VARIANTS}


def test_golden_trajectories_collect_and_hit_something():
    """Otherwise they would not see a change of Gather's rewards, or of the contacts with walls and blocks."""
    assert any(np.any(trajectories.load(each)["rewards"]) for each in VARIANTS if each.name.endswith("-gather"))
    for variant in VARIANTS:
        if variant.name.partition("-")[2] in trajectories.STARTS_M:
            seen = np.array(trajectories.load(variant)["observations"])
            assert (seen[:, :, 1].max(axis=1) > 3).all()  # they fly at what is 4 m away
            if "block_y" in (places := [element.name for element in variant.make_task(1).observation_spec]):
                assert (seen[:, -1, places.index("block_y")] > 0.01).any(), variant
