"""Checkpoints: everything to the bit, nothing executed, whole or not at all."""

import errno
import json
import os
import threading
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shes
from shes.errors import CheckpointError, StorageError
from shes.es.level import LevelState, RunningEpisodes, TrainState
from shes.es.novelty import NOVELTY_RULES, NoveltyState, make_novelty_rule
from shes.es.optimizers import OPTIMIZERS, OptimizerState, make_optimizer
from shes.es.statistics import ObservationStatistics
from shes.runs import checkpoint as checkpoints
from shes.runs.checkpoint import Best, Checkpoint, CheckpointWriter, load_checkpoint, save_checkpoint
from tests.e2e import runs

NUMBERS = {"env": "point-gather", "sigma": 0.1 + 0.2, "hidden": [4, 4]}


def level(rng, name, dim, size, optimizer="adam"):
    slots = {slot: rng.standard_normal(dim, dtype=np.float32) for slot in make_optimizer(optimizer).slots}
    return LevelState(
        name=name,
        theta=rng.standard_normal(dim, dtype=np.float32),
        optimizer=OptimizerState(steps=7, slots=slots),
        statistics=ObservationStatistics(count=10**12, total=rng.standard_normal(size), total_squares=rng.random(size)),
    )


def make(generation=7, seed=2**62, names=("controller", "primitive"), optimizer="adam", novelty=None, running=None):
    rng = np.random.default_rng(generation)
    levels = tuple(level(rng, name, 11 + 2 * i, 3 + i, optimizer) for i, name in enumerate(names))
    return Checkpoint(
        state=TrainState(
            seed=seed, generation=generation, env_steps=10**13, levels=levels, novelty=novelty, running=running
        ),
        best=Best(generation=5, score=1 / 3, mean_return=-2 / 3),
        numbers=NUMBERS,
    )


def assert_same(one, other):
    assert (one.best, one.numbers) == (other.best, other.numbers)
    for name in ("seed", "generation", "env_steps"):
        assert getattr(one.state, name) == getattr(other.state, name)
    for mine, theirs in zip(one.state.levels, other.state.levels, strict=True):
        assert mine.name == theirs.name
        assert (mine.optimizer.steps, mine.statistics.count) == (theirs.optimizer.steps, theirs.statistics.count)
        assert mine.optimizer.slots.keys() == theirs.optimizer.slots.keys()
        for first, second in (
            (mine.theta, theirs.theta),
            *((values, theirs.optimizer.slots[slot]) for slot, values in mine.optimizer.slots.items()),
            (mine.statistics.total, theirs.statistics.total),
            (mine.statistics.total_squares, theirs.statistics.total_squares),
        ):
            assert_same_bits(first, second)
    searches = (one.state.novelty, other.state.novelty)
    assert (searches[0] is None) == (searches[1] is None)
    if None not in searches:
        assert_same_bits(searches[0].archive, searches[1].archive)
        for name in ("weight", "best_return", "stalled"):
            assert repr(getattr(searches[0], name)) == repr(getattr(searches[1], name))
    running = (one.state.running, other.state.running)
    assert (running[0] is None) == (running[1] is None)
    if None not in running:
        assert_same_bits(running[0].states, running[1].states)
        assert_same_bits(running[0].steps, running[1].steps)


def assert_same_bits(first, second):
    assert (first.dtype, first.shape) == (second.dtype, second.shape)
    assert first.tobytes() == second.tobytes()


def test_a_checkpoint_reads_back_to_the_bit(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    assert_same(load_checkpoint(tmp_path / "a.npz"), make())


@pytest.mark.parametrize("names", [("policy",), ("primitive",), ("controller", "primitive")])
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_levels_and_optimizers_of_every_kind_read_back_to_the_bit(tmp_path, names, optimizer):
    whole = make(names=names, optimizer=optimizer)
    save_checkpoint(tmp_path / "a.npz", whole)
    read = load_checkpoint(tmp_path / "a.npz")
    assert_same(read, whole)
    assert [level.name for level in read.state.levels] == list(names)
    assert [tuple(level.optimizer.slots) for level in read.state.levels] == [make_optimizer(optimizer).slots] * len(
        names
    )
    with np.load(tmp_path / "a.npz") as file:
        kept = {name for name in file.files if "/" in name}
    assert {name.split("/")[0] for name in kept} == set(names)


@pytest.mark.parametrize("places", [0, 1, 37])
def test_the_search_for_novelty_reads_back_to_the_bit(tmp_path, places):
    archive = np.random.default_rng(1).normal(size=(places, 2))
    search = NoveltyState(archive=archive, weight=0.1 + 0.2, best_return=-1 / 3, stalled=4)
    save_checkpoint(tmp_path / "a.npz", make(novelty=search))
    assert_same(load_checkpoint(tmp_path / "a.npz"), make(novelty=search))


@pytest.mark.parametrize("rule", NOVELTY_RULES)
def test_the_start_of_a_search_for_novelty_reads_back(tmp_path, rule):
    """Its archive is empty, and its best return is minus infinity."""
    start = make_novelty_rule(rule).start()
    save_checkpoint(tmp_path / "a.npz", make(novelty=start))
    assert_same(load_checkpoint(tmp_path / "a.npz"), make(novelty=start))


def test_without_novelty_nothing_of_it_is_written(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    assert load_checkpoint(tmp_path / "a.npz").state.novelty is None
    with np.load(tmp_path / "a.npz") as file:
        assert not [name for name in file.files if "novelty" in name]


@pytest.mark.parametrize("groups", [1, 6])
def test_episodes_that_go_on_read_back_to_the_bit(tmp_path, groups):
    rng = np.random.default_rng(2)
    states = rng.normal(size=(groups, 52)) * 10.0 ** rng.integers(-300, 300, (groups, 52))
    whole = make(names=("primitive",), running=RunningEpisodes(states=states, steps=np.arange(-1, 25 * groups - 1, 25)))
    save_checkpoint(tmp_path / "a.npz", whole)
    assert_same(load_checkpoint(tmp_path / "a.npz"), whole)
    with np.load(tmp_path / "a.npz") as file:
        assert {name for name in file.files if name.startswith("running/")} == {"running/states", "running/steps"}


def test_a_checkpoint_without_episodes_that_go_on_reads_as_before_there_were_any(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    with np.load(tmp_path / "a.npz") as file:
        assert not [name for name in file.files if "running" in name]  # the arrays that version 0.2 wrote
    assert load_checkpoint(tmp_path / "a.npz").state.running is None


def in_the_first_format(path):
    """Rewrite the checkpoint at `path` as version 0.1 wrote it: Adam's arrays by its name, two levels unnamed."""
    with np.load(path) as file:
        arrays = {name.replace("/optimizer_", "/adam_"): file[name] for name in file.files if name != "levels"}
    numbers = json.loads(str(arrays["settings"]))
    if "common_random_numbers" in numbers:
        numbers["common_random_numbers"] = {"group": True, "off": False}[numbers["common_random_numbers"]]
    new = {"algorithm", "controller_output", "clock_frequency", "optimizer", "perturbation", "primitive", "novelty"}
    kept = json.dumps({name: value for name, value in numbers.items() if name not in new})
    np.savez(path, **{**arrays, "format": np.int64(1), "settings": np.array(kept)})


def test_the_first_format_holds_the_same(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    in_the_first_format(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        assert {"controller/adam_first", "primitive/adam_second", "primitive/adam_steps"} <= set(file.files)
        assert not [name for name in file.files if "optimizer" in name or name == "levels"]
    assert_same(load_checkpoint(tmp_path / "a.npz"), make())


def test_a_run_whose_levels_were_others_in_the_first_version_is_refused(tmp_path):
    """Then flagrun had a controller, too."""
    path = runs.train_tiny(tmp_path / "run", "point-flagrun", generations=1)
    checkpoint = load_checkpoint(path / "checkpoints" / "last.npz")
    levels = make().state.levels
    save_checkpoint(
        path / "checkpoints" / "last.npz", replace(checkpoint, state=replace(checkpoint.state, levels=levels))
    )
    with pytest.raises(
        CheckpointError,
        match=r"last\.npz has the levels controller, primitive, but a run of point-flagrun has primitive",
    ):
        shes.resume(path, generations=2)


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


def test_another_format_is_refused_by_its_number(tmp_path):
    save_checkpoint(tmp_path / "a.npz", make())
    with np.load(tmp_path / "a.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "a.npz", **{**arrays, "format": np.int64(99)})
    with pytest.raises(
        CheckpointError, match=r"has checkpoint format 99; this version of SHES reads 1 and 2\. Use the version"
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


def test_the_writer_writes_in_order_beside_the_callers_work(tmp_path, monkeypatch):
    may_go_on, written = threading.Event(), []

    def slow(path, checkpoint):
        may_go_on.wait(10)
        written.append((path.name, checkpoint.state.generation))

    monkeypatch.setattr(checkpoints, "save_checkpoint", slow)
    writer = CheckpointWriter()
    writer.write([tmp_path / "best", tmp_path / "last"], make(1))
    assert written == []  # the call has come back before anything was written
    may_go_on.set()
    writer.write([tmp_path / "last"], make(2))
    writer.close()
    assert written == [("best", 1), ("last", 1), ("last", 2)]


@pytest.mark.parametrize("then", ["write", "wait", "close"])
def test_a_write_that_failed_is_told_at_the_next_call(tmp_path, monkeypatch, then):
    writer = CheckpointWriter()
    monkeypatch.setattr("os.fsync", fail(errno.ENOSPC))
    writer.write([tmp_path / "last.npz"], make(1))
    more = ([tmp_path / "last.npz"], make(2)) if then == "write" else ()
    with pytest.raises(StorageError, match="the disk is full"):
        getattr(writer, then)(*more)
    writer.close()
    assert list(tmp_path.iterdir()) == []
