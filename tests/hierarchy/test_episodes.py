"""Tasks that workers share: every episode once."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from tests.hierarchy.made_up import make_task


@given(episodes=st.integers(1, 6), cuts=st.sets(st.integers(1, 5)))
def test_parts_have_every_episode_once_and_in_order(episodes, cuts):
    task = make_task(3, range(70, 70 + episodes), snapshot_steps=tuple(range(episodes)))
    borders = [0, *sorted(cut for cut in cuts if cut < episodes), episodes]
    parts = [task.part(*border) for border in pairwise(borders)]
    assert sum(len(part.slots) for part in parts) == episodes
    for name in ("slots", "seeds", "snapshot_steps"):
        assert sum((getattr(part, name) for part in parts), ()) == getattr(task, name), name
    for part in parts:
        assert (part.member, part.noise_index, part.signs) == (task.member, task.noise_index, task.signs)
        assert part.records_statistics == task.records_statistics
