"""Checkpoints: everything bit-identical, nothing executed, whole or not at all."""

import errno
import io
import os
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shes
from shes.errors import CheckpointError, ConfigError, StorageError
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint

NUMBERS = {"env": "point-gather", "sigma": 0.1 + 0.2, "hidden": [4, 4]}
NOT_WHOLE = "is not a whole SHES checkpoint"


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
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


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


@pytest.mark.parametrize("name", ["format", "settings", "best_score"])
def test_a_learner_has_no_array_of_the_runs_own_names(tmp_path, name):
    taken = replace(make(), arrays={**make().arrays, name: np.zeros(3)})
    with pytest.raises(ConfigError, match=rf"to_arrays\(\) names an array {name}, which"):
        save_checkpoint(tmp_path / "a.npz", taken)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (CheckpointError("has 9 arrays."), "has 9 arrays"),
        (KeyError("theta"), f"{NOT_WHOLE} .*theta.*--checkpoint last"),
    ],
)
def test_what_a_learner_complains_of_is_told_with_the_file(path, error, message):
    def refuse(arrays):
        raise error

    assert restore(make(), dict, path).keys() == make().arrays.keys()
    with pytest.raises(CheckpointError, match=rf"a\.npz {message}"):
        restore(make(), refuse, path)
    with pytest.raises(CheckpointError, match=rf"a\.npz {message}"):
        load_checkpoint(path, refuse)


@pytest.mark.parametrize(
    ("score", "mean_return", "is_better"),
    [(3.1, 0.0, True), (2.9, 9.0, False), (3.0, 1.1, True), (3.0, 0.9, False), (3.0, 1.0, True)],
)
def test_the_higher_score_wins_then_the_higher_return_then_the_later_one(score, mean_return, is_better):
    assert Best(generation=1, score=3.0, mean_return=1.0).is_beaten_by(score, mean_return) is is_better
    assert Best().is_beaten_by(-1000.0, -1000.0)


# Damaged files.


class Bomb:
    def __reduce__(self):
        return (os.abort, ())


def zip_of_text():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("readme.txt", "hello")
    return file.getvalue()


FILES = {
    "empty": b"",
    "pickle": np.array([Bomb()], dtype=object).dumps(),
    "text": zip_of_text(),
}


@pytest.mark.parametrize("case", FILES)
def test_another_programs_file_is_refused_and_not_executed(path, case):
    path.write_bytes(FILES[case])
    with pytest.raises(CheckpointError, match=rf"a\.npz {NOT_WHOLE} .*truncated.*--checkpoint last, best"):
        load_checkpoint(path)


def change(path, **arrays):
    """Give a checkpoint other arrays; those that are None go."""
    with np.load(path) as file:
        changed = {**file, **arrays}
    np.savez(path, **{name: array for name, array in changed.items() if array is not None})


WRONG = {
    "format": [None, np.array([Bomb()], dtype=object), np.array("x")],
    "seed": [None, np.int64(-5)],
    "generation": [None, np.int64(-1), np.zeros(2, np.int64), np.array("x")],
    "env_steps": [None, np.int64(-5)],
    "best_score": [None, np.float64("nan"), np.float64("inf"), np.array("1")],
    "best_return": [np.float64("inf")],
    "best_generation": [np.int64(-2), np.array([1, 2])],
    "settings": [None, np.array("[1]"), np.array("{"), np.array("[" * 100_000), np.array("7"), np.int64(3)],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_values_that_no_run_writes_are_refused(path, name, value):
    change(path, **{name: value})
    message = r"has checkpoint format x" if value is WRONG["format"][2] else NOT_WHOLE
    with pytest.raises(CheckpointError, match=rf"a\.npz {message}") as error:
        load_checkpoint(path)
    assert len(str(error.value)) < 800


@pytest.mark.parametrize("number", [1, 99])
def test_another_format_is_refused_by_its_number(path, number):
    change(path, format=np.int64(number))
    with pytest.raises(CheckpointError, match=rf"format {number}; this version of SHES reads 2\. Use the version"):
        load_checkpoint(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a checkpoint, and a place for damaged ones."""
    path = tmp_path_factory.mktemp("damaged") / "a.npz"
    save_checkpoint(path, make())
    return path.read_bytes(), path


def has_all_arrays(arrays):
    """Check the names of the arrays, as an algorithm does."""
    if arrays.keys() != make().arrays.keys():
        raise CheckpointError("is not of this run.")


@settings(max_examples=60)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_checkpoint_is_refused_wherever_it_was_cut(whole, share):
    data, path = whole
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(CheckpointError, match=rf"a\.npz {NOT_WHOLE}"):
        load_checkpoint(path)


@settings(max_examples=200)
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_a_flipped_byte_is_noticed_or_harmless(whole, place, value):
    data, path = whole
    damaged = bytearray(data)
    damaged[int(place * len(data))] = value
    path.write_bytes(damaged)
    try:
        read = load_checkpoint(path, has_all_arrays)
    except CheckpointError:
        return
    assert_same(read, make())  # it hit what nobody reads, such as a date


OF_ANOTHER_RUN = {
    "shape": (
        {"controller/theta": np.ones(1, np.float32)},
        r"holds controller/theta as float32 of shape \(1,\), where",
    ),
    "type": ({"controller/theta": np.ones(3, np.complex64)}, "holds controller/theta as complex64"),
    "unknown": ({"more": np.zeros(3)}, r"is not of this run: it has more\. Put back"),
    "levels": ({"levels": np.array(["controller"])}, "(holds|has the) levels"),
    "seed": ({"seed": np.int64(99)}, r"is damaged: its seed is 99, not \d"),
    "NaN": ({}, "holds NaN or infinity in controller/theta"),
}


@pytest.mark.parametrize("case", OF_ANOTHER_RUN)
def test_arrays_of_another_run_are_refused_by_whoever_reads_them(run_copy, case):
    arrays, message = OF_ANOTHER_RUN[case]
    for name in ("last", "best"):
        path = run_copy / "checkpoints" / f"{name}.npz"
        if case == "NaN":
            with np.load(path) as file:
                arrays = {"controller/theta": np.full_like(file["controller/theta"], np.nan)}
        change(path, **arrays)
    for go_on in (shes.load, shes.evaluate, lambda path: shes.resume(path, generations=9)):
        with pytest.raises(CheckpointError, match=rf"(last|best)\.npz {message}"):
            go_on(run_copy)


def test_a_missing_checkpoint_names_those_that_are_there(path):
    gone = path.with_name("c.npz")
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*c\.npz\. There are: a\. Choose one with --ch"):
        load_checkpoint(gone)
    path.unlink()
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*c\.npz\. Choose one with --checkpoint"):
        load_checkpoint(gone)


# Disks.


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
