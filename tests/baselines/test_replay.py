"""A replay buffer is a list of the last transitions; buffers that go on from one another share memory, not contents."""

from functools import reduce

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from shes.baselines.levels import Replay

CAPACITY, SLACK = 7, 3
EMPTY = Replay(shapes={"inputs": (2,), "reward": ()}, capacity=CAPACITY, slack=SLACK)


def transitions(first, count):
    numbers = np.arange(first, first + count, dtype=np.float32)
    return {"inputs": np.stack([numbers, -numbers], axis=1), "reward": numbers}


def appended(replay, first, count):
    """Return `replay` with `count` transitions, one after another."""
    return reduce(lambda made, number: made.append(transitions(number, 1)), range(first, first + count), replay)


def content(replay):
    assert all((part["inputs"][:, 1] == -part["reward"]).all() for part in replay.parts())
    return [float(reward) for part in replay.parts() for reward in part["reward"]]


@given(st.lists(st.integers(0, SLACK), max_size=30))
def test_it_holds_what_a_plain_list_holds(counts):
    replay, plain = EMPTY, []
    for count in counts:
        rows = transitions(len(plain), count)
        replay, plain = replay.append(rows), [*plain, *rows["reward"].tolist()]
        assert content(replay) == plain[-CAPACITY:]
        assert (replay.size, replay.end) == (min(len(plain), CAPACITY), len(plain))


@given(st.integers(1, 25), st.integers(0, 2**32))
def test_it_is_sampled_as_a_plain_list(count, seed):
    replay = appended(EMPTY, 0, count)
    drawn = replay.sample(np.random.default_rng(seed), 4, 5)
    assert drawn["inputs"].shape == (4, 5, 2)
    indices = np.random.default_rng(seed).integers(0, replay.size, (4, 5))
    np.testing.assert_array_equal(drawn["reward"], np.array(content(replay))[indices])


def test_a_buffer_stays_while_the_next_generation_is_stored():
    """So a checkpoint can be written meanwhile, without a copy."""
    replay = appended(EMPTY, 0, 25)
    arrays, before = replay.to_arrays(), content(replay)
    later = appended(replay, 25, SLACK)
    assert content(replay) == before
    assert [*arrays["older/reward"], *arrays["newer/reward"]] == before
    assert arrays["older/reward"].base is not None  # a view
    assert content(later) == list(map(float, range(21, 28)))
    later.append(transitions(28, 1))
    with pytest.raises(AssertionError, match="overwritten"):
        content(replay)


def test_two_buffers_that_go_on_from_one_are_apart():
    common = EMPTY.append(transitions(0, 3))
    one, other = common.append(transitions(10, 2)), common.append(transitions(20, 3))
    assert [content(each) for each in (common, one, other)] == [[0, 1, 2], [0, 1, 2, 10, 11], [0, 1, 2, 20, 21, 22]]
    emptied = one.emptied()
    assert (content(emptied), emptied.size, emptied.end) == ([], 0, 5)
    assert content(emptied.append(transitions(9, 1))) == [9]


@pytest.mark.parametrize("count", [0, 1, 6, 9, 10, 11, 24])
def test_it_is_restored_with_the_same_arrays_and_goes_on_alike(count):
    replay = appended(EMPTY, 0, count)
    restored = EMPTY.from_arrays({name: array.copy() for name, array in replay.to_arrays().items()})
    for _ in range(2):
        one, other = ({name: array.tolist() for name, array in each.to_arrays().items()} for each in (replay, restored))
        assert one == other
        replay, restored = (each.append(transitions(100, 2)) for each in (replay, restored))


def test_more_transitions_than_were_ever_made_are_refused():
    arrays = EMPTY.append(transitions(0, 3)).to_arrays()
    with pytest.raises(ValueError, match="has 3, of 2 ever made"):
        EMPTY.from_arrays({**arrays, "end": np.array(2)})
