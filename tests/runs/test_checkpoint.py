"""Checkpoints: everything bit-identical, nothing executed, whole or not at all."""

import errno
import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shes.errors import CheckpointError, ConfigError, StorageError
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint
from tests.messages import raises

NUMBERS = {"env": "point-gather", "sigma": 0.1 + 0.2, "hidden": [4, 4]}
NOT_WHOLE = "is not a whole SHES checkpoint"


def make(generation=7):
    """A checkpoint with arrays of every kind that a learner may have."""
    rng = np.random.default_rng(generation)
    counts = {"seed": 2**62, "generation": generation, "env_steps": 10**13}
    arrays = {
        "levels": np.array(["controller", "primitive"]),
        "controller/theta": rng.standard_normal(11, dtype=np.float32),
        "primitive/observation_total": rng.standard_normal(4),
        "archive": np.empty((0, 2)),
        "best": np.array(-np.inf),
        "is_new": np.array([True, False]),
        "running/steps": np.arange(-1, 5).reshape(2, 3),
    }
    return Checkpoint(
        arrays={name: np.array(count) for name, count in counts.items()} | arrays,
        best=Best(generation=5, score=1 / 3, mean_return=-2 / 3),
        numbers=NUMBERS,
    )


def assert_same(one, other):
    assert (one.best, one.numbers) == (other.best, other.numbers)
    assert one.arrays.keys() == other.arrays.keys()
    for name, mine in one.arrays.items():
        theirs = other.arrays[name]
        assert (mine.dtype, mine.shape, mine.tobytes()) == (theirs.dtype, theirs.shape, theirs.tobytes()), name


@pytest.fixture
def path(tmp_path):
    """The path of a checkpoint."""
    save_checkpoint(tmp_path / "a.npz", make())
    return tmp_path / "a.npz"


@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_checkpoint_reads_back_bit_identically(path, is_compressed):
    save_checkpoint(path, make(), is_compressed=is_compressed)
    read = load_checkpoint(path)
    assert_same(read, make())
    assert (read.generation, read.env_steps) == (7, 10**13)


def test_the_counts_are_read_without_the_state(path):
    theta = np.random.default_rng(1).standard_normal(100_000)
    save_checkpoint(path, replace(make(), arrays={**make().arrays, "controller/theta": theta}))
    content, end = path.read_bytes(), theta[-8:].tobytes()
    path.write_bytes(content.replace(end, end[::-1]))  # which is not read
    read = load_checkpoint(path, with_state=False)
    assert read.arrays.keys() == {"seed", "generation", "env_steps"}
    assert (read.best, read.numbers, read.generation) == (make().best, NUMBERS, 7)
    with pytest.raises(CheckpointError):
        load_checkpoint(path)


def test_a_learner_has_no_array_of_the_runs_own_names(tmp_path):
    taken = replace(make(), arrays={**make().arrays, "settings": np.zeros(3)})
    with raises(ConfigError, "to_arrays() names an array settings, which"):
        save_checkpoint(tmp_path / "a.npz", taken)
    assert list(tmp_path.iterdir()) == []


# Damaged files; others are in tests/e2e/test_bad_input.py.


class Bomb:
    def __reduce__(self):
        return (os.abort, ())


def change(path, **arrays):
    """Give a checkpoint other arrays; those that are None go."""
    with np.load(path) as file:
        changed = {**file, **arrays}
    np.savez(path, **{name: array for name, array in changed.items() if array is not None})


WRONG = {
    "format": [None, np.array([Bomb()], dtype=object), np.array("x"), np.int64(1), np.int64(99)],
    "best_score": [None],
    "best_generation": [np.array([1, 2])],
    "settings": [None, np.array("[1]"), np.array("{"), np.array("[" * 100_000), np.int64(3)],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_values_that_no_run_writes_are_refused(path, name, value):
    change(path, **{name: value})
    has_other_format = name == "format" and value is not None and value.dtype != object
    message = f"has checkpoint format {value}; this version of SHES reads 2" if has_other_format else NOT_WHOLE
    with raises(CheckpointError, f"a.npz {message}") as error:
        load_checkpoint(path)
    assert len(str(error.value)) < 800


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a checkpoint, and a place for damaged ones."""
    path = tmp_path_factory.mktemp("damaged") / "a.npz"
    save_checkpoint(path, make())
    return path.read_bytes(), path


def all_arrays(arrays):
    """Return the arrays if they have all names, as an algorithm does."""
    if arrays.keys() != make().arrays.keys():
        raise CheckpointError("is not of this run.")
    return arrays


@settings(max_examples=200)
@given(share=st.floats(0, 1, exclude_max=True), value=st.one_of(st.none(), st.integers(0, 255)))
def test_damage_is_noticed_or_harmless(whole, share, value):
    """A file that was cut off is refused. A changed byte may be one that nobody reads, such as of a date."""
    data, path = whole
    place = int(share * len(data))
    path.write_bytes(data[:place] if value is None else data[:place] + bytes([value]) + data[place + 1 :])
    try:
        read = load_checkpoint(path)
        restore(read, all_arrays, path)
    except CheckpointError:
        return
    assert value is not None
    assert_same(read, make())


FULL = (errno.ENOSPC, "the disk is full: make room, then start again ... `shes resume`")


@pytest.mark.parametrize(
    ("place", "number", "message"),
    [
        ("numpy.savez", *FULL),
        ("os.fsync", *FULL),
        ("pathlib.Path.replace", *FULL),
        ("pathlib.Path.open", errno.EDQUOT, "the disk quota is used up: make room"),
        ("pathlib.Path.open", errno.EROFS, "the file system is read-only: choose another folder with --out"),
        ("pathlib.Path.open", errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_a_failed_write_leaves_the_old_checkpoint_alone(tmp_path, monkeypatch, place, number, message):
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    path = tmp_path / "last.npz"
    save_checkpoint(path, make(1))
    monkeypatch.setattr(place, fail)
    with raises(StorageError, f"cannot write ... last.npz: {message} ... What was there before is untouched"):
        save_checkpoint(path, make(2))
    monkeypatch.undo()
    assert_same(load_checkpoint(path), make(1))
    assert list(tmp_path.iterdir()) == [path]
