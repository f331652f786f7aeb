"""The state of an evolution strategy as arrays: bit-identical after a round trip through a checkpoint file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.algorithms.evolution.state_arrays import from_arrays, to_arrays
from shes.errors import CheckpointError
from shes.es.level import LevelState, RunningEpisodes, TrainState
from shes.es.optimizers import OPTIMIZERS, OptimizerState
from shes.es.statistics import ObservationStatistics
from shes.runs.build import build_algorithm, open_run
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint
from shes.training.make_config import make_config
from tests.e2e import runs


def level(rng, name, dim, size, optimizer="adam"):
    slots = {slot: rng.standard_normal(dim, dtype=np.float32) for slot in OPTIMIZERS.find(optimizer)().slots}
    return LevelState(
        name=name,
        theta=rng.standard_normal(dim, dtype=np.float32),
        optimizer=OptimizerState(steps=7, slots=slots),
        statistics=ObservationStatistics(count=10**12, total=rng.standard_normal(size), total_squares=rng.random(size)),
    )


def make(names=("controller", "primitive"), optimizer="adam", running=None):
    rng = np.random.default_rng(7)
    levels = tuple(level(rng, name, 11 + 2 * i, 3 + i, optimizer) for i, name in enumerate(names))
    return TrainState(seed=2**62, generation=7, env_steps=10**13, levels=levels, running=running)


@pytest.fixture
def kept(tmp_path):
    """Return a function that takes a state to a file and back, and the arrays that were in the file."""

    def take(state):
        path = tmp_path / "a.npz"
        save_checkpoint(path, Checkpoint(arrays=to_arrays(state), best=Best(), numbers={}))
        checkpoint = load_checkpoint(path)
        return restore(checkpoint, from_arrays, path), checkpoint.arrays

    return take


def assert_same(one, other):
    for name in ("seed", "generation", "env_steps"):
        assert repr(getattr(one, name)) == repr(getattr(other, name))
    for mine, theirs in zip(one.levels, other.levels, strict=True):
        assert mine.name == theirs.name
        assert repr((mine.optimizer.steps, mine.statistics.count)) == repr(
            (theirs.optimizer.steps, theirs.statistics.count)
        )
        assert mine.optimizer.slots.keys() == theirs.optimizer.slots.keys()
        for first, second in (
            (mine.theta, theirs.theta),
            *((values, theirs.optimizer.slots[slot]) for slot, values in mine.optimizer.slots.items()),
            (mine.statistics.total, theirs.statistics.total),
            (mine.statistics.total_squares, theirs.statistics.total_squares),
        ):
            assert_same_bits(first, second)
    running = (one.running, other.running)
    assert (running[0] is None) == (running[1] is None)
    if None not in running:
        assert_same_bits(running[0].states, running[1].states)
        assert_same_bits(running[0].steps, running[1].steps)


def assert_same_bits(first, second):
    assert (first.dtype, first.shape) == (second.dtype, second.shape)
    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("names", [("policy",), ("primitive",), ("controller", "primitive")])
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_levels_and_optimizers_of_every_kind_read_back_to_the_bit(kept, names, optimizer):
    whole = make(names, optimizer)
    read, arrays = kept(whole)
    assert_same(read, whole)
    assert [level.name for level in read.levels] == list(names)
    assert [tuple(level.optimizer.slots) for level in read.levels] == [OPTIMIZERS.find(optimizer)().slots] * len(names)
    assert {name.split("/")[0] for name in arrays if "/" in name} == set(names)


@pytest.mark.parametrize("groups", [1, 6])
def test_episodes_that_go_on_read_back_to_the_bit(kept, groups):
    rng = np.random.default_rng(2)
    states = rng.normal(size=(groups, 52)) * 10.0 ** rng.integers(-300, 300, (groups, 52))
    whole = make(("primitive",), running=RunningEpisodes(states=states, steps=np.arange(-1, 25 * groups - 1, 25)))
    read, arrays = kept(whole)
    assert_same(read, whole)
    assert {name for name in arrays if name.startswith("running/")} == {"running/states", "running/steps"}


@pytest.mark.parametrize("name", ["running"])
def test_nothing_is_written_of_what_a_state_has_not(kept, name):
    read, arrays = kept(make())
    assert not [array for array in arrays if name in array]
    assert getattr(read, name) is None


def test_no_array_needs_pickle():
    arrays = to_arrays(make())
    assert {name for name, array in arrays.items() if array.dtype == object} == set()
    assert {"seed", "generation", "env_steps", "levels", "controller/theta", "primitive/observation_total"} <= set(
        arrays
    )


@pytest.mark.parametrize("name", ["levels", "primitive/theta", "controller/optimizer_steps"])
def test_a_state_of_which_something_is_missing_is_refused(tmp_path, name):
    arrays = to_arrays(make())
    del arrays[name]
    with pytest.raises(CheckpointError, match=rf"a\.npz is not a whole SHES checkpoint .KeyError: .*{name[-5:]}"):
        restore(Checkpoint(arrays=arrays, best=Best(), numbers={}), from_arrays, tmp_path / "a.npz")


@pytest.fixture(scope="module")
def learner():
    """A learner of two levels."""
    return build_algorithm(make_config("point-gather", "smoke", {"hidden": (4,)}))


@pytest.fixture(scope="module")
def arrays(learner):
    """The arrays of a state after a while, with episodes that go on."""
    state = learner.start(3)
    running = RunningEpisodes(states=np.ones((4, 52)), steps=np.array([-1, 0, 5, 7]))
    return learner.to_arrays(replace(state, generation=9, env_steps=77, running=running))


def refused(learner, arrays, message):
    with pytest.raises(CheckpointError, match=rf"^a\.npz {message}"):
        restore(Checkpoint(arrays=arrays, best=Best(), numbers={}), learner.from_arrays, Path("a.npz"))


def test_a_state_of_this_run_is_taken(learner, arrays):
    read = learner.from_arrays(arrays)
    assert (read.generation, read.env_steps, len(read.running.steps)) == (9, 77, 4)
    learner.from_arrays(learner.to_arrays(learner.start(3)))


def test_arrays_that_are_not_of_this_run_are_refused_by_name(learner, arrays):
    without = {name: array for name, array in arrays.items() if name != "env_steps"}
    refused(learner, without, r"is not of this run: it lacks env_steps\. Put back the checkpoint of this run")
    refused(learner, {**arrays, "z": np.zeros(1)}, r"is not of this run: it has z\. Put back")
    refused(learner, {**without, "z": np.zeros(1)}, r"is not of this run: it lacks env_steps and has z\. Put back")
    for name in ("running/states", "running/steps"):
        half = {each: array for each, array in arrays.items() if each != name}
        refused(learner, half, "has states or steps of running episodes, not both")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("controller/theta", lambda array: array[:-1]),
        ("primitive/theta", lambda array: array[None]),
        ("primitive/theta", lambda array: array.astype(np.int64)),
        ("primitive/optimizer_first", lambda array: np.concatenate([array, array])),
        ("controller/observation_total", lambda array: array.astype("U")),
        ("generation", lambda array: array[None]),
        ("generation", np.float64),
    ],
)
def test_an_array_of_another_shape_or_kind_is_refused(learner, arrays, name, change):
    refused(learner, {**arrays, name: np.asarray(change(arrays[name]))}, rf"holds {name} as .*, where this run has ")


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["controller/theta", "primitive/observation_total", "running/states"])
def test_a_number_that_is_none_is_refused(learner, arrays, name, wrong):
    array = arrays[name].copy()
    array.reshape(-1)[-1] = wrong
    refused(learner, {**arrays, name: array}, rf"holds NaN or infinity in {name}\. Take an earlier checkpoint\.")


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("generation", -1), ("seed", -1), ("primitive/optimizer_steps", -3), ("running/steps", [-1, 0, -2, 5])],
)
def test_a_count_below_none_is_refused(learner, arrays, name, wrong):
    refused(learner, {**arrays, name: np.array(wrong)}, rf"holds a negative number in {name}\. Put back the checkpoint")


@pytest.mark.parametrize("go_on", [shes.resume, shes.evaluate, shes.load])
def test_a_run_whose_levels_were_others_is_refused(tmp_path, go_on):
    """In version 0.1 flagrun had a controller, too."""
    path = runs.train_tiny(tmp_path / "run", "point-flagrun", generations=1)
    for name in ("last", "best"):
        file = path / "checkpoints" / f"{name}.npz"
        checkpoint = load_checkpoint(file)
        state = replace(open_run(path, name).state, levels=make().levels)
        save_checkpoint(file, replace(checkpoint, arrays=to_arrays(state)))
    settings = {"generations": 2} if go_on is shes.resume else {}
    with pytest.raises(
        CheckpointError,
        match=r"(last|best)\.npz has the levels controller, primitive, but a run of point-flagrun has primitive now\. "
        "Use the version that wrote it",
    ):
        go_on(path, **settings)
