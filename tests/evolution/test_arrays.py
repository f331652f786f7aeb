"""The state of an evolution strategy as arrays: bit-identical after a round trip through a checkpoint file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shes.errors import CheckpointError
from shes.rollout.episodes import Snapshot
from shes.runs.build import build_algorithm
from shes.runs.checkpoint import Best, Checkpoint, load_checkpoint, restore, save_checkpoint
from shes.runs.make_config import make_config
from tests.messages import raises
from tests.rollout.formula import bits


@pytest.fixture(scope="module")
def learner():
    """A learner of two levels that searches for a way."""
    settings = {"explore": "archive", "primitive_view": "egocentric", "hidden": (4,), "horizon": 30}
    return build_algorithm(make_config("point-push", "smoke", settings))


@pytest.fixture(scope="module")
def state(learner):
    """A state after a while, with episodes that go on."""
    levels = [replace(level, statistics=level.statistics.merge(10**12, level.statistics.mean + 1, level.statistics.std))
              for level in learner.start(3).levels]  # fmt: skip
    running = (None, *(Snapshot(state=np.full(52, 1e-300), steps=steps) for steps in (0, 5, 7)))
    return replace(learner.start(2**62), generation=9, env_steps=10**13, levels=tuple(levels), running=running)


@pytest.fixture(scope="module")
def arrays(learner, state):
    return learner.to_arrays(state)


def test_a_state_reads_back_to_the_bit(learner, state, tmp_path):
    for whole in (state, learner.start(3)):
        checkpoint = Checkpoint(arrays=learner.to_arrays(whole), best=Best(), numbers={})
        save_checkpoint(tmp_path / "a.npz", checkpoint)
        assert bits(restore(load_checkpoint(tmp_path / "a.npz"), learner.from_arrays, Path("a.npz"))) == bits(whole)


def without(*names):
    return lambda arrays: {name: array for name, array in arrays.items() if name not in names}


def ending_in(value):
    return lambda array: np.append(array.ravel()[:-1], value).reshape(array.shape).astype(array.dtype)


OTHER, NAN = "holds {} as ... , where this run has ", "NaN or infinity in {}"
OF_RUN = "is not of this run: it {} Put back"
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
    (lambda arrays: {**arrays, "z": np.zeros(1)}, OF_RUN.format("has z.")),
    (lambda arrays: {**without("seed")(arrays), "z": np.zeros(1)}, OF_RUN.format("lacks seed and has z.")),
    (without("running/steps"), OF_RUN.format("lacks running/steps.")),
    *((lambda arrays, at=name, do=change: {**arrays, at: np.asarray(do(arrays[at]))}, f" ... {told.format(name)}")
      for name, change, told in CHANGES),
]  # fmt: skip


@pytest.mark.parametrize(("harm", "message"), HARMS)
def test_arrays_that_are_not_of_this_run_are_refused(learner, arrays, harm, message):
    with raises(CheckpointError, f"a.npz {message}"):
        restore(Checkpoint(arrays=harm(arrays), best=Best(), numbers={}), learner.from_arrays, Path("a.npz"))
