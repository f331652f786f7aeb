"""The device of a run: what goes with it, that it is there before anything is written, and that the record names it."""

import json

import numpy as np
import pytest

import shes
import shes.algorithms.problem
import shes.algorithms.worker
import shes.runs.device
import shes.training.build
from shes.backends.serial import SerialBackend
from shes.errors import ConfigError
from shes.runs.config import TrainConfig
from shes.runs.device import check_asked_device, device_changes, device_facts
from shes.runs.sections import WorkerSettings, execution_settings
from shes.settings import setting_fields
from shes.sim.cpu import CpuSimulator
from shes.sim.warp_device import DEVICES
from shes.training.build import build_algorithm, build_backend
from shes.training.evaluate import evaluate
from shes.training.make_config import make_config
from tests.e2e import runs

NO_CARD = ConfigError("device cuda needs an NVIDIA card. Use --device cpu.")


@pytest.fixture
def stand_in(monkeypatch):
    """Let devices be there whose physics is that of the CPU."""
    monkeypatch.setattr(shes.training.build, "simulator_factory", lambda *_: CpuSimulator)
    monkeypatch.setattr(shes.algorithms.worker, "simulator_factory", lambda *_: CpuSimulator)
    monkeypatch.setattr(shes.algorithms.worker.RolloutWorker, "_chunk", lambda *_: 8)
    monkeypatch.setattr(shes.algorithms.worker.WarpDevice, "__init__", lambda *_: None)
    monkeypatch.setattr(shes.algorithms.worker.WarpDevice, "release_memory", lambda _: None)
    monkeypatch.setattr(shes.algorithms.problem.Problem, "xp", np)
    facts = {"cuda": {"name": "cuda", "card": "Card 1"}, "warp-cpu": {"name": "warp-cpu", "warp-lang": "1.19"}}
    monkeypatch.setattr("shes.runs.provenance.device_facts", lambda name: facts.get(name, {"name": name}))
    return facts


@pytest.fixture
def no_card(monkeypatch):
    def refuse(*_):
        raise NO_CARD

    monkeypatch.setattr(shes.training.build, "simulator_factory", lambda *_: refuse)


def record(path):
    return json.loads((path / "config.json").read_text())


def test_the_devices_are_the_cpu_and_those_of_warp():
    choices = setting_fields(WorkerSettings)["device"].choices
    assert choices == ("cpu", *DEVICES)


def test_the_device_and_its_buffers_are_no_part_of_what_a_run_is():
    assert {"device", "nconmax", "njmax"} <= execution_settings().keys()


@pytest.mark.parametrize("device", DEVICES)
def test_a_device_has_one_worker_in_this_process_whatever_the_default(device):
    config = make_config("point-gather", "smoke", {"device": device, "nconmax": 9, "njmax": 7, "chunk_size": 3})
    plan = build_algorithm(config).plan()
    assert (plan.device, plan.nconmax, plan.njmax, plan.chunk_size) == (device, 9, 7, 3)
    with build_backend(config, plan) as backend:
        assert isinstance(backend, SerialBackend)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"backend": "processes"},
            r"backend is 'processes', but one process serves device cuda\. Omit --backend",
        ),
        (
            {"num_workers": 4},
            r"num_workers is 4, but one process serves device cuda\. Omit --workers, or set --dev",
        ),
        ({"device": "cpu", "nconmax": 9}, r"nconmax is 9, but the CPU's .* no fixed buffers\. .*omit --nconmax"),
        ({"device": "cpu", "njmax": 9}, r"njmax is 9, but the CPU's .* no fixed buffers\. .*omit --njmax"),
    ],
)
def test_what_does_nothing_on_the_device_is_refused_where_it_is_asked_for(asked, message):
    with pytest.raises(ConfigError, match=message):
        make_config("point-gather", "smoke", {"device": "cuda", **asked})


@pytest.mark.parametrize("asked", [{"backend": "serial"}, {"num_workers": 1}, {"num_workers": 0}, {"nconmax": None}])
def test_what_changes_nothing_is_let_pass(asked):
    assert make_config("point-gather", "smoke", {"device": "cuda", **asked}).workers.device == "cuda"


def test_what_a_run_was_told_for_another_device_stays():
    config = TrainConfig.of(env="point-gather", backend="processes", num_workers=4, device="cuda")
    check_asked_device(config, {"device": "cuda"})
    check_asked_device(TrainConfig.of(env="point-gather", nconmax=9), {"device": "cpu"})


def test_an_environment_of_gymnasium_runs_on_the_cpu_alone(stand_in):
    message = (
        r"device is 'cuda', but gymnasium:Ant-v5 has physics of its own: it runs on the CPU alone\. Set --device cpu"
    )
    with pytest.raises(ConfigError, match=message):
        TrainConfig.of(env="gymnasium:Ant-v5", device="cuda")


def test_a_device_that_is_not_there_is_an_error_before_there_is_a_folder(no_card, tmp_path):
    with pytest.raises(ConfigError, match="needs an NVIDIA card"):
        shes.train("point-gather", preset="smoke", device="cuda", out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_cannot_go_on_on_a_device_is_as_it_was(no_card, run_copy):
    before = record(run_copy)
    with pytest.raises(ConfigError, match="needs an NVIDIA card"):
        shes.resume(run_copy, device="cuda", generations=5)
    with pytest.raises(ConfigError, match="num_workers is 2, but one process serves device warp-cpu"):
        shes.resume(run_copy, device="warp-cpu", num_workers=2)
    assert record(run_copy) == before


def test_the_record_says_on_which_device_every_part_ran(stand_in, run_copy, tmp_path):
    heard = []

    class Ear:
        def on_event(self, event):
            heard.append(event)

        def __getattr__(self, name):
            return lambda *_: None

    shes.resume(run_copy, device="cuda", generations=5, listener=Ear())
    shes.resume(run_copy, generations=6, listener=Ear())
    stand_in["cuda"] = {"name": "cuda", "card": "Card 2"}
    shes.resume(run_copy, generations=7, listener=Ear())
    shes.resume(run_copy, device="cpu", generations=8, listener=Ear())
    found = record(run_copy)
    assert found["device"] == {"name": "cpu"}
    assert [(part["generation"], part["device"].get("card")) for part in found["resumed"]] == [
        (4, "Card 1"),
        (5, "Card 1"),
        (6, "Card 2"),
        (7, None),
    ]
    assert found["config"]["workers"]["device"] == "cpu"
    assert heard == [
        f"not as before ({change}): numbers may differ from here on"
        for change in ("device cpu -> cuda", "card Card 1 -> Card 2", "device cuda -> cpu")
    ]
    log = runs.log_lines(run_copy)
    assert [line for line in log if line.startswith(("begins", "not"))][1:5] == [
        heard[0],
        "begins after generation 4 with 1 workers on device cuda",
        "begins after generation 5 with 1 workers on device cuda",
        heard[1],
    ]


def test_a_record_without_a_device_is_that_of_a_run_on_the_cpu(stand_in, run_copy):
    old = record(run_copy)
    del old["device"]
    (run_copy / "config.json").write_text(json.dumps(old))
    assert shes.resume(run_copy, generations=5).config.workers.device == "cpu"
    assert record(run_copy)["resumed"][0]["device"] == {"name": "cpu"}
    assert "not as before" not in (run_copy / "log.txt").read_text()


def test_changes_of_a_device_are_its_name_or_what_is_behind_it():
    one = {"name": "cuda", "card": "A", "driver": "CUDA 13.0"}
    assert device_changes(one, one) == []
    assert device_changes({"name": "cpu"}, one) == ["device cpu -> cuda"]
    assert device_changes(one, {**one, "driver": "CUDA 13.1"}) == ["driver CUDA 13.0 -> CUDA 13.1"]


def test_the_cpu_needs_no_warp(monkeypatch):
    monkeypatch.delattr(shes.runs.device, "WarpDevice")
    assert device_facts("cpu") == {"name": "cpu"}


def test_an_evaluation_is_on_the_cpu_unless_said(stand_in, run_copy, monkeypatch):
    shes.resume(run_copy, device="cuda", nconmax=9, generations=5)
    plans = []

    def noted(config, plan, *rest):
        plans.append(plan)
        return build_backend(config, plan, *rest)

    monkeypatch.setattr("shes.training.evaluate.build_backend", noted)
    on_cpu = evaluate(run_copy, episodes=2, num_workers=1)
    on_device = evaluate(run_copy, episodes=2, device="warp-cpu")
    evaluate(run_copy, episodes=2, device="warp-cpu", nconmax=5, njmax=4)
    assert [(plan.device, plan.nconmax, plan.njmax) for plan in plans] == [
        ("cpu", 9, None),
        ("warp-cpu", 9, None),
        ("warp-cpu", 5, 4),
    ]
    assert on_cpu.summary() == on_device.summary()  # the stand-in's physics
    for asked, message in (({"device": "cuda", "num_workers": 2}, "num_workers is 2"), ({"njmax": 2}, "njmax is 2")):
        with pytest.raises(ConfigError, match=message):
            evaluate(run_copy, **asked)


def test_too_little_memory_for_one_episode_is_an_error_before_there_is_a_folder(monkeypatch, tmp_path):
    def full(*_):
        raise RuntimeError("Failed to allocate 10800000000 bytes on device 'cuda:0'")

    monkeypatch.setattr(shes.training.build, "simulator_factory", lambda *_: full)
    with pytest.raises(ConfigError, match=r"cuda has too little memory for a single episode .*--nconmax or --njmax"):
        shes.train("point-gather", out=tmp_path / "run", preset="smoke", device="cuda")
    assert not (tmp_path / "run").exists()
