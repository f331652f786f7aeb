"""Shipped agents: named wherever a run folder may stand, and never written into."""

import json
import shlex
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import shes
from shes import cli
from shes.errors import ConfigError, RunFolderError, UnknownNameError
from shes.runs import shipped
from shes.runs.build import build_environment, build_options
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.shipped import AGENTS, read_agent, shipped_name, shipped_names
from shes.runs.tables import read_csv
from shes.settings import setting_fields
from tests.e2e import runs
from tests.messages import raises

FILES = {"agent.json", "checkpoints", "config.json", "evaluation.csv", "progress.csv"}


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_name_is_found_and_a_path_wins_over_it(elsewhere, run_copy):
    for name in ("ant-gather", Path("ant-gather")):
        assert RunFolder.open(name).path == AGENTS / "ant-gather"
    run_copy.rename("ant-gather")
    assert RunFolder.open("ant-gather").path == Path("ant-gather")
    assert shes.load("ant-gather").config.run.env == "point-gather"


def test_what_is_no_agent_is_refused_by_saying_why(elsewhere, monkeypatch):
    Path("ant-walker").mkdir()
    with raises(RunFolderError, "no config.json ... It hides the shipped agent ant-walker: rename it"):
        shes.load("ant-walker")
    monkeypatch.setattr(shipped, "AGENTS", elsewhere / "nowhere")
    with pytest.raises(RunFolderError, match=r"\(its --out\)\.$"):
        shes.load("gone")
    with raises(UnknownNameError, "unknown shipped agent 'x'. Known: . `shes list` shows them"):
        read_agent("x")


def test_the_primitive_of_a_shipped_agent_is_brought_by_name(elsewhere):
    path = runs.train_tiny(Path("run"), "ant-gather", primitive="ant-walker", generations=1)
    record = json.loads((path / "config.json").read_text())
    assert record["config"]["transfer"]["primitive"] == record["primitive"]["run"] == "ant-walker"
    assert "config" not in record["primitive"]  # it counts by its name
    brought, own = (runs.state(run, "best").levels[-1] for run in ("ant-walker", path))
    assert own.theta.tobytes() == brought.theta.tobytes()


@pytest.mark.slow
def test_a_copy_of_a_shipped_agent_can_be_trained_on(elsewhere):
    shutil.copytree(AGENTS / "ant-walker", "mine")
    shutil.copy("mine/checkpoints/best.npz", "mine/checkpoints/last.npz")
    best = read_agent("ant-walker").generation
    assert shes.resume("mine", generations=best + 1).generation == best + 1


@pytest.mark.parametrize("change", [list, lambda told: {**told, "evaluation": {}}])
def test_a_damaged_agent_file_is_an_error_that_names_it(elsewhere, monkeypatch, change):
    shutil.copytree(AGENTS / "ant-gather", "agents/ant-gather")
    monkeypatch.setattr(shipped, "AGENTS", elsewhere / "agents")
    file = elsewhere / "agents" / "ant-gather" / "agent.json"
    file.write_text(json.dumps(change(json.loads(file.read_text()))))
    with raises(RunFolderError, "agent.json is damaged: ... Install SHES again"):
        read_agent("ant-gather")


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_agent_is_small_complete_and_acts(name):
    folder, told = RunFolder.open(name), read_agent(name)
    assert {path.name for path in folder.path.iterdir()} == FILES
    assert [path.name for path in folder.checkpoints.iterdir()] == ["best.npz"]
    assert folder.checkpoint_path("best").stat().st_size < 200_000
    assert sum(path.stat().st_size for path in folder.path.rglob("*") if path.is_file()) < 500_000
    assert shipped_name(folder.path) == name
    assert folder.read_config().run.env == told.env
    assert folder.load("best").generation == told.generation
    assert told.description.strip()
    assert min(told.cores, told.hours, told.env_steps, told.generation, told.evaluation.episodes) > 0
    for other in (told.evaluation.constant, told.evaluation.random):
        assert (other is not None) == ("controller" in folder.read_config().level_names)
        assert other is None or (other.episodes, other.controller == "trained") == (told.evaluation.episodes, False)
    for values in (read_csv(folder.progress), read_csv(folder.evaluation)):
        assert 0 < len(values["generation"]) <= 300
    assert "/home/" not in folder.config.read_text()
    record, last = folder.read_record(), shlex.split(told.commands[-1])
    for option, given in pairwise(last):  # runs have one name everywhere
        if option in ("--out", "--primitive"):
            assert (option, given) in pairwise(record["command"])
        if option == "--primitive":
            assert record["config"]["transfer"]["primitive"] == given
            assert record["primitive"]["run"] == given.removesuffix("@last")
    agent, config = shes.load(name), folder.read_config()
    task = build_environment(config).make(1, build_options(config, is_evaluation=True))
    task.reset(np.array([0]), [1])
    control = agent.control(task.observe(), task.position, task.heading, task.goal)
    assert np.isfinite(control).all()
    task.step(np.array([0]), control)
    assert not task.diverged.any()
    task.close()


@pytest.mark.parametrize("name", shipped_names())
def test_the_command_of_a_shipped_agent_gives_its_settings(name, monkeypatch):
    def train(env, *, preset, out, progress, **settings):
        asked.update(settings)
        raise ConfigError(f"{env} is not trained here")

    asked: dict[str, object] = {}
    monkeypatch.setattr("shes.runs.train.train", train)
    assert cli.main(shlex.split(read_agent(name).commands[-1])[1:]) == 2
    trained = RunFolder.open(name).read_config()
    beside = set(trained.algorithm.transfers)
    asked |= dict.fromkeys(asked.keys() & beside, name)
    gives, had = make_config(trained.run.env, overrides=asked).numbers(), trained.numbers()
    if trained.values["primitive"] and trained.values["freeze_primitive"]:
        beside |= {*setting_fields(type(trained.estimate))}  # how a primitive that is frozen would have learned
    assert {s: v for s, v in gives.items() if s not in beside} == {s: v for s, v in had.items() if s not in beside}
