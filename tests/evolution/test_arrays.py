"""The state of an evolution strategy as arrays: bit-identical after a round trip through a checkpoint file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shes.errors import CheckpointError
from shes.es.level import LevelState
from shes.es.optimizers import OPTIMIZERS, OptimizerState
from shes.es.statistics import ObservationStatistics
from shes.evolution.state import RunningEpisodes, TrainState, from_arrays, to_arrays
from shes.runs.build import build_algorithm
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint
from shes.runs.make_config import make_config
from tests.rollout.formula import bits


def level(rng, name, dim, size, optimizer):
    return LevelState(
        name=name,
        theta=rng.standard_normal(dim, dtype=np.float32),
        optimizer=OptimizerState(
            steps=7,
            slots={slot: rng.standard_normal(dim, dtype=np.float32) for slot in OPTIMIZERS.find(optimizer)().slots},
        ),
        statistics=ObservationStatistics(count=10**12, total=rng.standard_normal(size), total_squares=rng.random(size)),
    )


def make(names, optimizer, groups):
    """Return a state of levels with made-up numbers; with `groups`, so many episodes go on."""
    rng = np.random.default_rng(7)
    levels = tuple(level(rng, name, 11 + 2 * i, 3 + i, optimizer) for i, name in enumerate(names))
    states = rng.normal(size=(groups, 52)) * 10.0 ** rng.integers(-300, 300, (groups, 52))
    running = RunningEpisodes(states=states, steps=np.arange(-1, 25 * groups - 1, 25)) if groups else None
    return TrainState(seed=2**62, generation=7, env_steps=10**13, levels=levels, running=running)


@pytest.mark.parametrize("names", [("policy",), ("primitive",), ("controller", "primitive")])
@pytest.mark.parametrize("optimizer", OPTIMIZERS)
@pytest.mark.parametrize("groups", [0, 1, 6])
def test_every_kind_of_state_reads_back_to_the_bit(tmp_path, names, optimizer, groups):
    whole, path = make(names, optimizer, groups), tmp_path / "a.npz"
    save_checkpoint(path, Checkpoint(arrays=to_arrays(whole), best=Best(), numbers={}))
    checkpoint = load_checkpoint(path)
    assert bits(restore(checkpoint, from_arrays, path)) == bits(whole)
    assert {name for name, array in checkpoint.arrays.items() if array.dtype == object} == set()
    running = {"running/states", "running/steps"} if groups else set()
    slots = [f"optimizer_{slot}" for slot in OPTIMIZERS.find(optimizer)().slots]
    statistics = ["observation_count", "observation_total", "observation_total_squares"]
    own = {f"{name}/{each}" for name in names for each in ("theta", "optimizer_steps", *slots, *statistics)}
    assert checkpoint.arrays.keys() == {"seed", "generation", "env_steps", "levels", *own, *running}


@pytest.fixture(scope="module")
def learner():
    """A learner of two levels that searches for a way."""
    settings = {"explore": "archive", "primitive_view": "egocentric", "hidden": (4,), "horizon": 30}
    return build_algorithm(make_config("point-push", "smoke", settings))


@pytest.fixture(scope="module")
def arrays(learner):
    """The arrays of a state after a while, with episodes that go on."""
    running = RunningEpisodes(states=np.ones((4, 52)), steps=np.array([-1, 0, 5, 7]))
    return learner.to_arrays(replace(learner.start(3), generation=9, env_steps=77, running=running))


def test_a_state_of_this_run_is_taken(learner, arrays):
    read = learner.from_arrays(arrays)
    assert (read.generation, read.env_steps, len(read.running.steps)) == (9, 77, 4)
    assert bits(learner.from_arrays(learner.to_arrays(learner.start(3)))) == bits(learner.start(3))


def without(*names):
    return lambda arrays: {name: array for name, array in arrays.items() if name not in names}


def ending_in(value):
    return lambda array: np.append(array.ravel()[:-1], value).reshape(array.shape).astype(array.dtype)


OF_RUN, OTHER, NAN = (
    "is not of this run: it {} Put back",
    "holds {} as .*, where this run has ",
    "NaN or infinity in {}",
)
CHANGES = [
    ("controller/theta", lambda array: array[:-1], OTHER),
    ("primitive/theta", lambda array: array[None], OTHER),
    ("primitive/theta", lambda array: array.astype(np.int64), OTHER),
    ("controller/observation_total", lambda array: array.astype("U"), OTHER),
    ("generation", lambda array: array[None], OTHER),
    ("archive/states", lambda array: array[0], OTHER),
    ("running/states", lambda array: array[0], OTHER),
    *((name, ending_in(np.nan), NAN) for name in ("controller/theta", "primitive/observation_total", "running/states")),
    ("controller/theta", ending_in(np.inf), NAN),
]
HARMS = [
    (without("env_steps"), OF_RUN.format("lacks env_steps.")),
    (lambda arrays: {**arrays, "z": np.zeros(1)}, OF_RUN.format("has z.")),
    (lambda arrays: {**without("seed")(arrays), "z": np.zeros(1)}, OF_RUN.format("lacks seed and has z.")),
    (without("running/states"), OF_RUN.format("lacks running/states.")),
    (without("running/steps"), OF_RUN.format("lacks running/steps.")),
    *(
        (
            lambda arrays, at=name, change=change: {**arrays, at: np.asarray(change(arrays[at]))},
            f".*{told.format(name)}",
        )
        for name, change, told in CHANGES
    ),
]


@pytest.mark.parametrize(("harm", "message"), HARMS)
def test_arrays_that_are_not_of_this_run_are_refused(learner, arrays, harm, message):
    with pytest.raises(CheckpointError, match=rf"^a\.npz {message}"):
        restore(Checkpoint(arrays=harm(arrays), best=Best(), numbers={}), learner.from_arrays, Path("a.npz"))
