"""Checkpoints that no run has written: each is one clear error, and nothing is allocated or read for it."""

import contextlib
import io
import shutil
import tracemalloc
import zipfile

import numpy as np
import pytest

import shes
from shes.errors import CheckpointError
from shes.runs import checkpoint as checkpoints
from shes.runs.build import open_run
from shes.runs.checkpoint import load_checkpoint
from tests.e2e import runs

THETA = "controller/theta.npy"
MOST_BYTES = 20_000_000
"""Most memory that refusing a checkpoint takes."""
MANY = 8_000_000
"""Elements of an array of float32 that is larger than that."""


def header(shape, dtype="<f4"):
    """Return the header of an array as bytes."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue()


def member(array):
    """Return an array as the bytes of a member."""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.fixture
def change(run_copy):
    """Return a function that gives members of both checkpoints of a run other bytes."""

    def rewrite(**members):
        for name in ("last", "best"):
            path = run_copy / "checkpoints" / f"{name}.npz"
            with zipfile.ZipFile(path) as archive:
                content = {each: archive.read(each) for each in archive.namelist()}
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                for each, data in {**content, **members}.items():
                    if data is not None:
                        archive.writestr(each, data)
        return run_copy

    return rewrite


@contextlib.contextmanager
def little_memory():
    """Check that what is done takes little memory. Tracing makes it several times slower."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    finally:
        tracemalloc.stop()


def refused(run, message, limit=contextlib.nullcontext):
    """Check that every way to use the checkpoints of `run` is refused, within `limit` and with one line."""
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    for go_on in (shes.load, shes.evaluate, lambda path: shes.resume(path, generations=9)):
        with limit(), pytest.raises(CheckpointError, match=rf"(last|best)\.npz {message}") as error:
            go_on(run)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 800
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_header_that_claims_more_than_there_is_allocates_nothing(change):
    message = r"is not a whole SHES checkpoint .*controller/theta of "
    refused(change(**{THETA: header((10**12,)) + bytes(40)}), message, little_memory)


def test_an_unknown_member_is_not_read(change):
    large = member(np.zeros(MANY, np.float32))
    refused(change(**{"more.npy": large}), r"is not of this run: it has more\. Put back", little_memory)


def test_a_larger_array_is_not_read(change):
    message = rf"holds controller/theta as float32 of shape \({MANY},\), where this run has "
    refused(change(**{THETA: member(np.zeros(MANY, np.float32))}), message, little_memory)


def test_arrays_that_do_not_fit_the_memory_are_not_read(change, monkeypatch):
    run = change()
    monkeypatch.setattr(checkpoints, "free_memory", lambda: 100)
    refused(run, r"holds 0\.0 GB of arrays, but 0\.0 GB of memory are free\. Take another one", little_memory)


WRONG = {
    "scalar": (np.float32(1), "holds controller/theta as float32 of shape"),
    "one": (np.ones(1, np.float32), r"holds controller/theta as float32 of shape \(1,\), where this run has"),
    "complex": (np.ones(3, np.complex64), "holds controller/theta as complex64"),
    "text": (np.array(["a"]), "holds controller/theta as <U1"),
    "double": (None, "holds controller/theta as float64"),
}


@pytest.mark.parametrize("case", WRONG)
def test_parameters_of_another_shape_or_type_are_refused(change, case):
    array, message = WRONG[case]
    run = change()
    if array is None:
        array = open_run(run, "last").state.levels[0].theta.astype(np.float64)
    refused(change(**{THETA: member(array)}), message)


BYTES = {
    "short": (header((3,)) + bytes(11), "is not a whole SHES checkpoint .*does not have 12 bytes"),
    "empty": (b"", "is not a whole SHES checkpoint"),
    "negative": (header((-1, -4)) + bytes(16), "is not a whole SHES checkpoint .*shape"),
    "of_nothing": (header((10**15,), "<U0"), "is not a whole SHES checkpoint .*shape"),
    "long": (header((3,)).replace(b"(3,)", b"3" * 4), "is not a whole SHES checkpoint"),
    "nested": (header((3,)).replace(b"(3,)", b"(" * 4), "is not a whole SHES checkpoint"),
    "newer": (header((3,)).replace(b"\x01\x00", b"\x09\x00", 1) + bytes(12), "is not a whole .*version .9, 0."),
}


@pytest.mark.parametrize("case", BYTES)
def test_members_that_are_no_arrays_are_refused(change, case):
    data, message = BYTES[case]
    refused(change(**{THETA: data}), message)


def test_a_member_that_is_no_array_by_name_is_refused(change):
    refused(change(**{"read.me": b"hello"}), "is not a whole SHES checkpoint .*'read.me' is not an array")
    # A name must not write on the terminal.
    refused(
        change(**{"read.me": None, "\x1b[2J.npy": member(np.zeros(1))}),
        r"is not a whole SHES checkpoint .*'.x1b\[2J.npy' is not",
    )


SCALARS = {
    "generation.npy": [np.int64(-1), np.float64(1), np.zeros(2, np.int64), np.complex64(1), np.array("7")],
    "env_steps.npy": [np.int64(-5)],
    "seed.npy": [np.int64(-5)],
    "best_score.npy": [np.float64("nan"), np.float64("inf"), np.array("1")],
    "best_return.npy": [np.float64("inf")],
    "best_generation.npy": [np.int64(-2), np.array([1, 2])],
    "format.npy": [np.array([2]), np.float64(2)],
    "settings.npy": [np.array("[1]"), np.array("{"), np.array("[" * 100_000), np.array("7"), np.int64(3)],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in SCALARS.items() for value in values])
def test_numbers_and_settings_that_no_run_writes_are_refused(change, name, value):
    refused(change(**{name: member(value)}), "is not a whole SHES checkpoint")


def test_another_seed_than_that_of_the_settings_is_refused(change):
    refused(change(**{"seed.npy": member(np.int64(99))}), r"is damaged: its seed is 99, not \d")


def test_settings_of_many_megabytes_are_not_read(change):
    large = member(np.array("[" * 6_000_000))
    refused(change(**{"settings.npy": large}), "is not a whole SHES checkpoint .*settings", little_memory)


@pytest.mark.parametrize(
    "levels", [np.array([]), np.array(["controller"]), np.array(["primitive", "controller"]), np.array([1, 2])]
)
def test_levels_of_another_run_are_refused(change, levels):
    refused(change(**{"levels.npy": member(levels)}), r"(holds|has the) levels")


def test_the_arrays_of_an_unknown_algorithm_are_all_read(tmp_path, tiny_run):
    assert len(load_checkpoint(tiny_run / "checkpoints" / "last.npz").arrays) > 10


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A run whose episodes go on from generation to generation."""
    settings = {"primitive_estimate": "interval", "horizon": 1000, "generations": 1}
    path = runs.train_tiny(tmp_path_factory.mktemp("running") / "run", "point-flagrun", **settings)
    whole = shutil.copytree(path, path.with_name("whole"))
    assert shes.resume(whole, generations=2).generation == 2  # as it is, it goes on
    return path


@pytest.mark.parametrize("name", ["running/states", "running/steps"])
@pytest.mark.parametrize("axis", [0, -1])
def test_running_episodes_of_another_number_or_robot_are_refused(tmp_path, running, name, axis):
    run = shutil.copytree(running, tmp_path / "run")
    path = run / "checkpoints" / "last.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{**arrays, name: np.delete(arrays[name], 0, axis)})
    with pytest.raises(CheckpointError, match=rf"last\.npz holds {name} of shape .*, where this run has \("):
        shes.resume(run, generations=2)
