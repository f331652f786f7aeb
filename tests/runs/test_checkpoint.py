"""Checkpoints: everything bit-identical, nothing executed, whole or not at all."""

import errno
import os
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shes.errors import CheckpointError, ConfigError, StorageError
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint

NUMBERS = {"env": "point-gather", "sigma": 0.1 + 0.2, "hidden": [4, 4]}


def make(generation=7):
    """A checkpoint with arrays of every kind that a learner may have."""
    rng = np.random.default_rng(generation)
    arrays = {
        "seed": np.int64(2**62),
        "generation": np.int64(generation),
        "env_steps": np.int64(10**13),
        "levels": np.array(["controller", "primitive"]),
        "controller/theta": rng.standard_normal(11, dtype=np.float32),
        "primitive/observation_total": rng.standard_normal(4),
        "archive": np.empty((0, 2)),
        "best": np.float64(-np.inf),
        "is_new": np.array([True, False]),
        "running/steps": np.arange(-1, 5).reshape(2, 3),
    }
    return Checkpoint(
        arrays={name: np.asarray(values) for name, values in arrays.items()},
        best=Best(generation=5, score=1 / 3, mean_return=-2 / 3),
        numbers=NUMBERS,
    )


def assert_same(one, other):
    assert (one.best, one.numbers) == (other.best, other.numbers)
    assert one.arrays.keys() == other.arrays.keys()
    for name, mine in one.arrays.items():
        theirs = other.arrays[name]
        assert (mine.dtype, mine.shape, mine.tobytes()) == (theirs.dtype, theirs.shape, theirs.tobytes()), name


@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_checkpoint_reads_back_to_the_bit(tmp_path, is_compressed):
    save_checkpoint(tmp_path / "a.npz", make(), is_compressed=is_compressed)
    read = load_checkpoint(tmp_path / "a.npz")
    assert_same(read, make())
    assert (read.generation, read.env_steps) == (7, 10**13)


def test_the_counts_are_read_without_the_state(tmp_path):
    theta = np.random.default_rng(1).standard_normal(100_000)
    save_checkpoint(tmp_path / "a.npz", replace(make(), arrays={**make().arrays, "controller/theta": theta}))
    content, end = (tmp_path / "a.npz").read_bytes(), theta[-8:].tobytes()
    assert content.count(end) == 1
    (tmp_path / "a.npz").write_bytes(content.replace(end, end[::-1]))  # which is not read
    read = load_checkpoint(tmp_path / "a.npz", with_state=False)
    assert read.arrays.keys() == {"seed", "generation", "env_steps"}
    assert (read.best, read.numbers, read.generation) == (make().best, NUMBERS, 7)
    with pytest.raises(CheckpointError):
        load_checkpoint(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["format", "settings", "best_score", "owes_evaluation"])
def test_a_learner_has_no_array_of_the_runs_own_names(tmp_path, name):
    taken = replace(make(), arrays={**make().arrays, name: np.zeros(3)})
    with pytest.raises(ConfigError, match=rf"to_arrays\(\) names an array {name}, which"):
        save_checkpoint(tmp_path / "a.npz", taken)
    assert list(tmp_path.iterdir()) == []


def test_a_learner_gets_its_arrays_and_the_path_is_in_what_it_complains_of(tmp_path):
    path, checkpoint = tmp_path / "a.npz", make()
    assert restore(checkpoint, dict, path).keys() == checkpoint.arrays.keys()

    def refuse(arrays):
        raise CheckpointError(f"has {len(arrays)} arrays.")

    with pytest.raises(CheckpointError, match=r"a\.npz has 10 arrays\.$"):
        restore(checkpoint, refuse, path)


@pytest.mark.parametrize("error", [KeyError("theta"), ValueError("theta"), TypeError("theta")])
def test_arrays_that_a_learner_cannot_read_are_told_with_their_file(tmp_path, error):
    def stumble(arrays):
        raise error

    with pytest.raises(CheckpointError, match=r"a\.npz is not a whole SHES checkpoint .*theta.*--checkpoint last"):
        restore(make(), stumble, tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["format", "seed", "generation", "env_steps", "best_generation", "settings"])
def test_a_checkpoint_of_which_something_is_missing_is_refused(tmp_path, name):
    save_checkpoint(tmp_path / "a.npz", make())
    with np.load(tmp_path / "a.npz") as file:
        arrays = {each: file[each] for each in file.files if each != name}
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(CheckpointError, match=rf"a\.npz is not a whole SHES checkpoint .KeyError: .*{name}"):
        load_checkpoint(tmp_path / "a.npz")


def test_a_run_without_an_evaluation_has_no_best(tmp_path):
    save_checkpoint(tmp_path / "a.npz", replace(make(), best=Best()))
    best = load_checkpoint(tmp_path / "a.npz").best
    assert best == Best()
    assert best.is_beaten_by(-1000.0, -1000.0)


@pytest.mark.parametrize(
    ("score", "mean_return", "is_better"),
    [(3.1, 0.0, True), (2.9, 9.0, False), (3.0, 1.1, True), (3.0, 0.9, False), (3.0, 1.0, True)],
)
def test_the_higher_score_wins_then_the_higher_return_then_the_later_one(score, mean_return, is_better):
    assert Best(generation=1, score=3.0, mean_return=1.0).is_beaten_by(score, mean_return) is is_better


def test_no_array_needs_pickle(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert {name for name in file.files if file[name].dtype == object} == set()
        assert {"controller/theta", "primitive/observation_total", "format", "levels", "settings"} <= set(file.files)


class Bomb:
    def __reduce__(self):
        return (os.abort, ())


def test_code_in_a_strangers_file_is_not_executed(tmp_path):
    np.savez(tmp_path / "a.npz", format=np.array([Bomb()], dtype=object))
    with pytest.raises(CheckpointError, match="not a whole SHES checkpoint"):
        load_checkpoint(tmp_path / "a.npz")
    (tmp_path / "b.npz").write_bytes(np.array([Bomb()], dtype=object).dumps())
    with pytest.raises(CheckpointError, match="not a whole SHES checkpoint"):
        load_checkpoint(tmp_path / "b.npz")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a checkpoint, and a place for damaged ones."""
    path = tmp_path_factory.mktemp("damaged") / "a.npz"
    save_checkpoint(path, make())
    return path.read_bytes(), path


@settings(max_examples=60)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_checkpoint_is_refused_wherever_it_was_cut(whole, share):
    data, path = whole
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        CheckpointError, match=r"a\.npz is not a whole SHES checkpoint .*truncated.*--checkpoint last, best"
    ):
        load_checkpoint(path)


@settings(max_examples=200)
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_a_flipped_byte_is_noticed_or_harmless(whole, place, value):
    data, path = whole
    damaged = bytearray(data)
    damaged[int(place * len(data))] = value
    path.write_bytes(damaged)
    try:
        read = load_checkpoint(path)
    except CheckpointError:
        return
    assert_same(read, make())  # it hit what nobody reads, such as a date


@pytest.mark.parametrize("number", [1, 99])
def test_another_format_is_refused_by_its_number(tmp_path, number):
    save_checkpoint(tmp_path / "a.npz", make())
    with np.load(tmp_path / "a.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "a.npz", **{**arrays, "format": np.int64(number)})
    with pytest.raises(
        CheckpointError, match=rf"has checkpoint format {number}; this version of SHES reads 2\. Use the version"
    ):
        load_checkpoint(tmp_path / "a.npz")


def test_a_zip_of_something_else_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("readme.txt", "hello")
    with pytest.raises(CheckpointError, match="not a whole SHES checkpoint"):
        load_checkpoint(tmp_path / "a.npz")


def test_a_missing_checkpoint_names_those_that_are_there(tmp_path):
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*c\.npz\. Choose one with --checkpoint"):
        load_checkpoint(tmp_path / "c.npz")
    save_checkpoint(tmp_path / "b.npz", make())
    save_checkpoint(tmp_path / "a.npz", make())
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*c\.npz\. There are: a, b\. Choose one"):
        load_checkpoint(tmp_path / "c.npz")


def fail(number):
    def raises(*arguments, **keywords):
        raise OSError(number, os.strerror(number))

    return raises


@pytest.mark.parametrize("place", ["numpy.savez", "os.fsync", "pathlib.Path.replace", "pathlib.Path.open"])
@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.ENOSPC, "the disk is full: make room, then start again .*`shes resume`"),
        (errno.EDQUOT, "the disk quota is used up: make room"),
        (errno.EROFS, "the file system is read-only: choose another folder with --out"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_a_failed_write_leaves_the_old_checkpoint_and_nothing_else(tmp_path, monkeypatch, place, number, message):
    path = tmp_path / "last.npz"
    save_checkpoint(path, make(1))
    monkeypatch.setattr(place, fail(number))
    with pytest.raises(StorageError, match=rf"cannot write .*last\.npz: {message}.*What was there before is untouched"):
        save_checkpoint(path, make(2))
    monkeypatch.undo()
    assert_same(load_checkpoint(path), make(1))
    assert list(tmp_path.iterdir()) == [path]
