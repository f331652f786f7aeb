"""Tasks that workers share: every episode once, and results joined as if a task had been done as a whole."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.hierarchy.made_up import make_result, make_task


@given(episodes=st.integers(1, 6), cuts=st.sets(st.integers(1, 5)))
def test_parts_have_every_episode_once_and_in_order(episodes, cuts):
    task = make_task(3, range(70, 70 + episodes), snapshot_steps=tuple(range(episodes)))
    borders = [0, *sorted(cut for cut in cuts if cut < episodes), episodes]
    parts = [task.part(*border) for border in pairwise(borders)]
    assert sum(part.num_units for part in parts) == task.num_units == episodes
    for name in ("slots", "seeds", "snapshot_steps"):
        assert sum((getattr(part, name) for part in parts), ()) == getattr(task, name), name
    for part in parts:
        assert (part.member, part.noise_index, part.signs) == (task.member, task.noise_index, task.signs)
        assert part.records_statistics == task.records_statistics


@pytest.mark.parametrize("member", [2, 3], ids=["with statistics", "without"])
def test_joined_results_are_those_of_the_whole_task(member):
    task = make_task(member, (5, 6, 7))
    whole = make_result(task, log=("a", "b"))
    first, rest = make_result(task.part(0, 1), log=("a",)), make_result(task.part(1, 3), log=("b",))
    joined = task.join([first, rest])
    assert np.array_equal(joined.outcomes, whole.outcomes)
    assert (joined.moments is None) == (whole.moments is None) == (member == 3)
    for mine, expected in zip(joined.moments or (), whole.moments or (), strict=True):
        for name in ("count", "total", "total_squares"):
            assert getattr(mine, name).tobytes() == getattr(expected, name).tobytes()
    assert joined.log == ("a", "b")
    assert joined.snapshots == [*first.snapshots, *rest.snapshots]
    assert joined.seconds.tolist() == (2 * whole.seconds).tolist()
