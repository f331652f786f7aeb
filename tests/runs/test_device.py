"""The machine of a run: what does not fit it is refused before anything is made, and the record names it."""

import json
import sys
import tracemalloc
from importlib import metadata

import numpy as np
import pytest

import shes
import shes.algorithms.problem
import shes.rollout.worker
import shes.runs.build
import shes.runs.provenance
from shes.backends.backend import SerialBackend
from shes.backends.processes import ProcessesBackend
from shes.errors import ConfigError
from shes.evolution.estimates import draw_episodes
from shes.machine import num_cores
from shes.rollout.results import PopulationResults
from shes.runs import device
from shes.runs.build import build_algorithm, build_backend
from shes.runs.config import TrainConfig
from shes.runs.device import check_asked_device, check_limits, max_workers, most_episodes
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.provenance import provenance
from shes.runs.run_settings import WorkerSettings, execution_settings
from shes.settings import setting_fields
from shes.sim.cpu import CpuSimulator
from shes.sim.warp_device import DEVICES
from tests.e2e import runs


def record(path):
    return json.loads((path / "config.json").read_text())


# Devices.


@pytest.fixture
def stand_in(monkeypatch):
    """Let devices be there whose physics is that of the CPU; return what is told of each."""
    facts = {"cuda": {"name": "cuda", "card": "Card 1"}, "warp-cpu": {"name": "warp-cpu", "warp-lang": "1.19"}}

    class Device:
        def __init__(self, name):
            self.facts = facts[name]

        def release_memory(self):
            pass

    monkeypatch.setattr(shes.runs.build, "simulator_factory", lambda *_: CpuSimulator)
    monkeypatch.setattr(shes.rollout.worker, "simulator_factory", lambda *_: CpuSimulator)
    monkeypatch.setattr(shes.rollout.worker.RolloutWorker, "_most_lanes", lambda *_: 8)
    monkeypatch.setattr(shes.rollout.worker, "WarpDevice", Device)
    monkeypatch.setattr(shes.runs.provenance, "WarpDevice", Device)
    monkeypatch.setattr(shes.algorithms.problem.Problem, "xp", np)
    return facts


def test_the_device_is_one_of_warps_or_the_cpu_and_no_part_of_what_a_run_is():
    assert setting_fields(WorkerSettings)["device"].choices == ("cpu", *DEVICES)
    assert {"device", "nconmax", "njmax"} <= execution_settings().keys()


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_has_one_worker_in_this_process_whatever_the_default(name):
    config = make_config("point-gather", "smoke", {"device": name, "nconmax": 9, "njmax": 7, "chunk_size": 3})
    plan = build_algorithm(config).plan()
    assert (plan.device, plan.nconmax, plan.njmax, plan.chunk_size) == (name, 9, 7, 3)
    with build_backend(config, plan) as backend:
        assert isinstance(backend, SerialBackend)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"backend": "processes"}, r"backend is 'processes', but one process serves device cuda\. Omit --backend"),
        ({"num_workers": 4}, r"num_workers is 4, but one process serves device cuda\. Omit --workers, or set --dev"),
        ({"device": "cpu", "nconmax": 9}, r"nconmax is 9, but the CPU's .* no fixed buffers\. .*omit --nconmax"),
        ({"device": "cpu", "njmax": 9}, r"njmax is 9, but the CPU's .* no fixed buffers\. .*omit --njmax"),
        ({"backend": "serial"}, None),
        ({"num_workers": 1}, None),
        ({"num_workers": 0, "nconmax": None}, None),
    ],
)
def test_what_does_nothing_on_the_device_is_refused_where_it_is_asked_for(asked, message):
    if message is None:
        assert make_config("point-gather", "smoke", {"device": "cuda", **asked}).workers.device == "cuda"
        return
    with pytest.raises(ConfigError, match=message):
        make_config("point-gather", "smoke", {"device": "cuda", **asked})


def test_what_a_run_was_told_for_another_device_stays():
    config = TrainConfig.of(env="point-gather", backend="processes", num_workers=4, device="cuda")
    check_asked_device(config, {"device": "cuda"})
    check_asked_device(TrainConfig.of(env="point-gather", nconmax=9), {"device": "cpu"})


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ConfigError("device cuda needs an NVIDIA card."), "needs an NVIDIA card"),
        (
            RuntimeError("Failed to allocate 10800000000 bytes on device 'cuda:0'"),
            "cuda has too little memory for a si",
        ),
    ],
)
def test_a_device_that_cannot_be_used_is_an_error_that_changes_nothing(monkeypatch, tmp_path, run_copy, error, message):
    def refuse(*_):
        raise error

    monkeypatch.setattr(shes.runs.build, "simulator_factory", lambda *_: refuse)
    before = record(run_copy)
    with pytest.raises(ConfigError, match=message):
        shes.train("point-gather", preset="smoke", device="cuda", out=tmp_path / "run")
    with pytest.raises(ConfigError, match=message):
        shes.resume(run_copy, device="cuda", generations=5)
    assert not (tmp_path / "run").exists()
    assert record(run_copy) == before


def test_the_record_says_on_which_device_every_part_ran(stand_in, run_copy):
    heard = []
    listener = type("Ear", (), {"on_event": lambda _, event: heard.append(event)})()
    old = record(run_copy)
    del old["device"]  # as in an older run, which was on the CPU
    (run_copy / "config.json").write_text(json.dumps(old))
    for generation, settings in ((5, {}), (6, {"device": "cuda"}), (7, {}), (8, {}), (9, {"device": "cpu"})):
        if generation == 8:
            stand_in["cuda"] = {"name": "cuda", "card": "Card 2"}
        shes.resume(run_copy, generations=generation, listener=listener, **settings)
    found = record(run_copy)
    cards = [(part["generation"], part["device"].get("card")) for part in found["resumed"]]
    assert cards == [(4, None), (5, "Card 1"), (6, "Card 1"), (7, "Card 2"), (8, None)]
    assert found["config"]["workers"]["device"] == "cpu"
    changes = ("device cpu -> cuda", "card Card 1 -> Card 2", "device cuda -> cpu")
    assert heard == [f"not as before ({change}): numbers may differ from here on" for change in changes]
    log = runs.log_lines(run_copy)
    assert set(heard) <= set(log)
    assert "begins after generation 5 with 1 workers on device cuda" in log


def test_an_evaluation_is_on_the_cpu_unless_said(stand_in, run_copy, monkeypatch):
    shes.resume(run_copy, device="cuda", nconmax=9, generations=5)
    plans = []

    def noted(config, plan, *rest):
        plans.append((plan.device, plan.nconmax, plan.njmax))
        return build_backend(config, plan, *rest)

    monkeypatch.setattr("shes.runs.evaluate.build_backend", noted)
    on_cpu = evaluate(run_copy, episodes=2, num_workers=1)
    on_device = evaluate(run_copy, episodes=2, device="warp-cpu")
    evaluate(run_copy, episodes=2, device="warp-cpu", nconmax=5, njmax=4)
    assert plans == [("cpu", 9, None), ("warp-cpu", 9, None), ("warp-cpu", 5, 4)]
    assert on_cpu.summary() == on_device.summary()  # the stand-in's physics
    with pytest.raises(ConfigError, match="num_workers is 2"):
        evaluate(run_copy, device="cuda", num_workers=2)


# Versions.


@pytest.fixture
def installed(monkeypatch):
    """The versions of the installed packages, which tests change. None of the packages can be imported."""
    found = {**dict.fromkeys(("shes", "mujoco", "numpy"), "1"), "jax": "0.10.2"}

    def version(name):
        if name not in found:
            raise metadata.PackageNotFoundError(name)
        return found[name]

    monkeypatch.setattr(metadata, "version", version)
    for name in ("jax", "optax"):
        monkeypatch.setitem(sys.modules, name, None)
    return found


@pytest.mark.parametrize(("algorithm", "own"), [("hiro", {"jax"}), ("shes", set())])
def test_a_run_records_the_installed_packages_that_its_algorithm_names(installed, algorithm, own):
    config = make_config("point-gather", "smoke", {"algorithm": algorithm})
    versions = provenance("cpu", config.algorithm.packages)["versions"]
    assert versions.keys() == {"python", "shes", "mujoco", "numpy"} | own


def test_a_resume_says_which_versions_have_changed(installed, tmp_path):
    config, folder = make_config("point-gather", "smoke", {"algorithm": "hiro"}), RunFolder.create(tmp_path / "run")
    folder.record_start(config, {})
    installed["jax"] = "0.11.0"
    assert folder.record_resume(1, config) == ["jax 0.10.2 -> 0.11.0"]


# Memory and workers.


@pytest.fixture
def small_machine(monkeypatch):
    """A machine with 2 GB of free memory."""
    monkeypatch.setattr(device, "free_memory", lambda: 2 * 10**9)


SIZES = ["population_size", "episodes_per_policy", "evaluation_episodes", "horizon", "evaluation_horizon"]


@pytest.mark.parametrize("settings", [{name: 10**12} for name in SIZES] + [{"num_workers": 60, "backend": "processes"}])
def test_what_does_not_fit_the_memory_is_refused_before_there_is_a_folder(tmp_path, small_machine, settings):
    settings = {"population_size": 1000, **settings}
    with pytest.raises(
        ConfigError, match=r"^this takes [\d,.]+ GB of memory, but 2\.0 GB are free\. Lower --chunk-size"
    ):
        runs.train_tiny(tmp_path / "run", **settings)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("preset", ["smoke", "laptop"])
def test_the_presets_fit_a_small_machine(small_machine, preset):
    config = make_config("ant-gather", preset, {"num_workers": 8})
    check_limits(config, build_algorithm(config).design)


def test_the_estimate_covers_what_tasks_and_results_take(monkeypatch):
    config = make_config("ant-gather", "smoke", {"population_size": 20_000, "backend": "serial"})
    algorithm = build_algorithm(config)
    tracemalloc.start()
    draws = draw_episodes(algorithm.start(0), algorithm.hyperparameters, 1_000_000)
    results = PopulationResults.of_tasks(draws.tasks, draws.generation)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert results.outcomes.size == 20_000
    for free, fits in ((taken, False), (6 * taken, True)):
        monkeypatch.setattr(device, "free_memory", lambda free=free: free)
        if fits:
            check_limits(config, algorithm.design)
        else:
            with pytest.raises(ConfigError, match="GB of memory"):
                check_limits(config, algorithm.design)


def test_workers_far_above_the_cores_are_refused(tmp_path, tiny_run):
    value = max_workers() + 1
    message = rf"num_workers is {value:,}, but this machine has {num_cores()} cores: .* Set --workers {max_workers()} "
    with pytest.raises(ConfigError, match=message):
        runs.train_tiny(tmp_path / "run", backend="processes", num_workers=value)
    assert list(tmp_path.iterdir()) == []
    path = runs.train_tiny(tmp_path / "run", backend="processes", num_workers=1, generations=1)
    for go_on in (shes.evaluate, lambda path, **workers: shes.resume(path, generations=9, **workers)):
        with pytest.raises(ConfigError, match=message):
            go_on(path, num_workers=value)


def test_there_are_never_more_workers_than_episodes(tmp_path, monkeypatch):
    started, original = [], ProcessesBackend.__init__

    def init(self, factory, num_workers, **options):
        started.append(num_workers)
        original(self, factory, 1, **options)

    monkeypatch.setattr(ProcessesBackend, "__init__", init)
    path = runs.train_tiny(tmp_path / "run", backend="processes", num_workers=60, generations=1)
    shes.evaluate(path, num_workers=60, episodes=3)
    shes.evaluate(path, num_workers=2, episodes=5)
    assert started == [8, 3, 2]


def test_the_noise_table_is_checked_before_the_run_folder_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "cache"))
    with pytest.raises(
        ConfigError, match=r"noise_table_size is 1,000,000,000,000, which takes 4,000\.0 GB, but .*most"
    ):
        runs.train_tiny(tmp_path / "run", noise_table_size=10**12)
    assert list(tmp_path.iterdir()) == []


BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric", "primitive_population_size": 30}


@pytest.mark.parametrize(
    ("settings", "policies"), [({"episodes_per_policy": 2}, 32), (BRANCHES, 16 + 30), ({"algorithm": "td3"}, 0)]
)
def test_an_algorithm_tells_how_many_episodes_take_memory(settings, policies):
    config = make_config("point-gather", "smoke", {**settings, "evaluation_episodes": 1})
    assert most_episodes(config) == max(policies, 1)
    assert most_episodes(config, is_evaluation=True) == 1
