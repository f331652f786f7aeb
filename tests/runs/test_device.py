"""The machine of a run: what does not fit it is refused before anything is made, and the record names it."""

import json
import re
import sys
import tracemalloc
from importlib import metadata
from types import SimpleNamespace

import pytest

import shes
from shes.backends.processes import ProcessesBackend
from shes.errors import ConfigError
from shes.evolution.estimates import draw_episodes
from shes.evolution.strategies import SHES
from shes.rollout.episodes import empty_outcomes
from shes.rollout.roll_out import PopulationResults
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.e2e import runs
from tests.messages import raises
from tests.runs.recorder import recording


def record(path):
    return json.loads((path / "config.json").read_text())


@pytest.fixture
def stand_in(monkeypatch):
    """A record of devices whose physics is that of the CPU; its `facts` are what is told of each."""
    facts = {"cuda": {"name": "cuda", "card": "Card 1"}, "warp-cpu": {"name": "warp-cpu", "warp-lang": "1.19"}}
    monkeypatch.setattr("shes.runs.folder.WarpDevice", lambda name: SimpleNamespace(facts=facts[name]))
    with recording() as record:
        record.facts = facts
        yield record


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({}, ConfigError("no cluster"), "no cluster"),
        ({"device": "cuda"}, ConfigError("device cuda needs an NVIDIA card."), "needs an NVIDIA card"),
        ({"device": "cuda"}, RuntimeError("Failed to allocate 9 bytes on device 'cuda:0'"), "cuda has too little mem"),
    ],
)
def test_workers_that_cannot_start_change_nothing(monkeypatch, tmp_path, tiny_run, run_copy, settings, error, message):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr("shes.runs.build.WarpSimulator", refuse)
    monkeypatch.setattr("shes.runs.train.build_backend", refuse)
    before = record(run_copy)
    with raises(ConfigError, message):
        runs.train_tiny(tmp_path / "run", **settings)
    with raises(ConfigError, message):
        shes.resume(run_copy, generations=5, **settings)
    assert not (tmp_path / "run").exists()
    assert record(run_copy) == before
    assert runs.differences(tiny_run, run_copy) == []


def test_the_record_says_on_which_device_every_part_ran(stand_in, run_copy):
    def age(old):
        del old["device"]  # an older run, which was on the CPU
        old["config"]["workers"]["num_workers"] = 4  # for the CPU: a device does not mind

    heard = []
    runs.change_json(run_copy / "config.json", age)
    for generation, settings in ((5, {}), (6, {"device": "cuda"}), (7, {}), (8, {}), (9, {"device": "cpu"})):
        if generation == 8:
            stand_in.facts["cuda"] = {"name": "cuda", "card": "Card 2"}
        shes.resume(run_copy, generations=generation, listener=SimpleNamespace(on_event=heard.append), **settings)
    found = record(run_copy)
    cards = [(part["generation"], part["device"].get("card")) for part in found["resumed"]]
    assert cards == [(4, None), (5, "Card 1"), (6, "Card 1"), (7, "Card 2"), (8, None)]
    assert found["config"]["workers"]["device"] == "cpu"
    changes = ("device cpu -> cuda", "card Card 1 -> Card 2", "device cuda -> cpu")
    assert heard == [f"not as before ({change}): numbers may differ from here on" for change in changes]
    log = runs.log_lines(run_copy)
    assert set(heard) <= set(log)
    assert "begins after generation 5 with 1 workers on device cuda" in log


def test_an_evaluation_is_on_the_cpu_unless_said(stand_in, run_copy):
    def buffers():
        found = [tuple(each.values()) for each in stand_in.device_simulators]
        stand_in.device_simulators.clear()
        return list(dict.fromkeys(found))

    shes.resume(run_copy, device="cuda", nconmax=9, njmax=7, generations=5)
    assert buffers() == [("cuda", 9, 7, False)]
    on_cpu = shes.evaluate(run_copy, episodes=2, num_workers=1)
    assert buffers() == []
    on_device = shes.evaluate(run_copy, episodes=2, device="warp-cpu")
    shes.evaluate(run_copy, episodes=2, device="warp-cpu", nconmax=5, njmax=4, deterministic=True)
    assert buffers() == [("warp-cpu", 9, 7, False), ("warp-cpu", 5, 4, True)]
    assert on_cpu.summary() == on_device.summary()  # the stand-in's physics
    for asked in ({"device": "cuda", "num_workers": 2}, {"njmax": 2}):
        with pytest.raises(ConfigError):
            shes.evaluate(run_copy, **asked)


def test_a_run_records_its_packages_and_a_resume_their_changes(monkeypatch, tmp_path):
    found = {**dict.fromkeys(("shes", "mujoco", "numpy"), "1"), "jax": "0.10.2"}

    def version(name):
        if name not in found:
            raise metadata.PackageNotFoundError(name)
        return found[name]

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setattr(SHES, "packages", ("jax", "optax"))  # none of them can be imported
    for name in SHES.packages:
        monkeypatch.setitem(sys.modules, name, None)
    path, heard = runs.train_tiny(tmp_path / "run", generations=1), []
    assert record(path)["versions"].keys() == {"python", "shes", "mujoco", "numpy", "jax"}
    found["jax"] = "0.11.0"
    shes.resume(path, generations=2, listener=SimpleNamespace(on_event=heard.append))
    assert heard == ["not as before (jax 0.10.2 -> 0.11.0): numbers may differ from here on"]


class BegunError(Exception):
    """A run has come as far as to start its workers."""


@pytest.fixture
def fits(tmp_path, monkeypatch):
    """Return a function that tells whether a run of these settings may begin with `free` bytes of memory."""

    def begin(*_):
        raise BegunError

    def ask(free, env="point-gather", **settings):
        monkeypatch.setattr("resource.getrlimit", lambda _: (free, free))  # as by `ulimit -v`
        with pytest.raises((BegunError, ConfigError)) as stop:
            shes.train(env, out=tmp_path / "run", **{"preset": "smoke", "noise_table_size": 1_000_000, **settings})
        assert list(tmp_path.iterdir()) == []
        message = rf"this takes [\d,.]+ GB of memory, but {free / 1e9:.1f} GB are free\. Lower --chunk-size"
        return stop.type is BegunError or not re.match(message, str(stop.value))

    monkeypatch.setattr("shes.runs.train.build_backend", begin)
    return ask


SIZES = ["population_size", "episodes_per_policy", "evaluation_episodes", "horizon", "evaluation_horizon"]


def test_what_does_not_fit_the_memory_leaves_no_folder(fits):
    for settings in (*({name: 10**12} for name in SIZES), {"num_workers": 60, "backend": "processes"}):
        assert not fits(2 * 10**9, **{"population_size": 1000, **settings})
    for preset in ("smoke", "laptop"):
        assert fits(2 * 10**9, "ant-gather", preset=preset, num_workers=8)


def test_the_estimate_covers_what_tasks_and_results_take(fits):
    settings = {"population_size": 20_000, "backend": "serial", "chunk_size": 1}
    algorithm = build_algorithm(make_config("ant-gather", "smoke", settings))
    tracemalloc.start()
    draws = draw_episodes(algorithm.start(0), algorithm.hyperparameters, 1_000_000)
    results = PopulationResults(outcomes=empty_outcomes(len(draws.levels), 20_000, 1))  # noqa: F841 - held
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not fits(taken, "ant-gather", **settings)
    assert fits(6 * taken, "ant-gather", **settings)


def test_there_are_never_more_workers_than_episodes(tmp_path, run_copy, monkeypatch):
    def begin(backend, factory, num_workers, **_):
        raise BegunError(num_workers)

    def train(**settings):
        runs.train_tiny(tmp_path / "run", backend="processes", num_workers=60, evaluation_episodes=1, **settings)

    monkeypatch.setattr(ProcessesBackend, "__init__", begin)
    runs.change_json(run_copy / "config.json", lambda found: found["config"]["workers"].update(backend="processes"))
    branches = {"primitive_estimate": "interval", "primitive_view": "egocentric", "primitive_population_size": 30}
    for start, expected in (
        (train, 8),
        (lambda: train(episodes_per_policy=2), 16),
        (lambda: train(**branches), 8 + 30),
        (lambda: shes.evaluate(run_copy, num_workers=60, episodes=3), 3),
        (lambda: shes.evaluate(run_copy, num_workers=2, episodes=5), 2),
    ):
        with pytest.raises(BegunError) as caught:
            start()
        assert caught.value.args == (expected,)
