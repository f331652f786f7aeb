"""Agents that are shipped: small run folders without local paths, with what a fresh evaluation finds again."""

import io
import json
from contextlib import redirect_stdout
from dataclasses import asdict

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.ship import ship
from shes.runs import shipped
from shes.runs.checkpoint import load_checkpoint
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.shipped import read_agent
from shes.runs.tables import read_csv
from tests.e2e import runs

TOLD = {"description": "A point that walks.", "commands": ["shes train point-flagrun"]}
COMMANDS = ["shes train a", "shes train b"]
GATHERER = ["point-gather", "--description", "A point.", *(f"--command={each}" for each in COMMANDS)]
FILES = {"agent.json", "checkpoints", "config.json", "evaluation.csv", "progress.csv"}


@pytest.fixture(scope="module")
def walker_run(tmp_path_factory):
    """A run that trained a primitive alone, with episodes that go on. Not to be changed."""
    branches = {"primitive_estimate": "interval", "primitive_view": "proprioception", "controller_interval": 5}
    settings = {"generations": 1, "hidden": (1,), "horizon": 40, **branches}
    return runs.train_tiny(tmp_path_factory.mktemp("walker") / "run", "point-flagrun", **settings)


@pytest.fixture(scope="module")
def place(tmp_path_factory, tiny_run, walker_run):
    """A folder with two agents, one of which the command has shipped. Not to be changed."""
    folder = tmp_path_factory.mktemp("shipped") / "agents"
    ship(walker_run, "point-walker", **TOLD, episodes=3, num_workers=1, into=folder)
    words = [*GATHERER, "--earlier", str(tiny_run), "--episodes", "3", "--seed", "7", "--workers", "1"]
    with redirect_stdout(io.StringIO()) as out:
        assert main(["ship", str(tiny_run), *words, "--into", str(folder)]) == 0
    assert out.getvalue() == (folder / "point-gather" / "agent.json").read_text()
    return folder


@pytest.fixture
def agents(place, tmp_path, monkeypatch):
    """The same as the package's own, from an empty working directory."""
    monkeypatch.setattr(shipped, "AGENTS", place)
    monkeypatch.chdir(tmp_path)
    return place


def test_an_agent_is_a_run_folder_without_what_training_needs(agents, walker_run):
    folder = agents / "point-walker"
    assert {path.name for path in folder.iterdir()} == FILES
    assert [path.name for path in (folder / "checkpoints").iterdir()] == ["best.npz"]
    assert {path.name for path in agents.iterdir()} == {"point-gather", "point-walker"}  # nothing else is left
    whole, small = walker_run / "checkpoints" / "best.npz", folder / "checkpoints" / "best.npz"
    assert small.stat().st_size < whole.stat().st_size
    one, other = load_checkpoint(whole), load_checkpoint(small)
    assert (one.best, one.generation, one.env_steps) == (other.best, other.generation, other.env_steps)
    before, after = (runs.state(path, "best") for path in (walker_run, folder))
    assert (before.running is None, after.running) == (False, None)  # the episodes
    for level, copy in zip(before.levels, after.levels, strict=True):
        assert level.theta.tobytes() == copy.theta.tobytes()
        assert level.statistics.total.tobytes() == copy.statistics.total.tobytes()
        assert (level.optimizer.steps, copy.optimizer.steps) == (1, 0)
        assert all(values.any() for values in level.optimizer.slots.values())
        assert not any(values.any() for values in copy.optimizer.slots.values())


def test_what_is_told_of_an_agent_is_what_evaluation_finds_again(agents, tiny_run):
    told, checkpoint = read_agent("point-gather"), RunFolder.open(tiny_run).load("best")
    assert (told.description, told.commands) == ("A point.", COMMANDS)
    assert (told.env, told.cores, told.env_steps) == ("point-gather", 1, 2 * 640)
    assert told.generation == checkpoint.generation
    assert 0 <= told.hours < 0.1
    result, scores = asdict(told)["evaluation"], {"episodes", "score_mean", "score_std", "success_rate"}
    for controller in ("constant", "random"):
        found = evaluate("point-gather", episodes=3, seed=7, controller=controller)
        other = result.pop(controller)
        assert other == {"controller": found.controller, **{name: found.summary()[name] for name in scores}}
    found = evaluate("point-gather", episodes=3, seed=7).summary()
    assert (result.pop("seed"), result.pop("controller")) == (7, "trained")
    assert result == {name: found[name] for name in {*scores, "return_mean", "episode_steps_mean"}}
    walker = read_agent("point-walker").evaluation
    assert (walker.seed, walker.controller, walker.constant, walker.random) == (None, None, None, None)


def test_no_path_of_this_machine_is_shipped(walker_run, tmp_path):
    run = runs.train_tiny(tmp_path / "run", primitive=str(walker_run), generations=1)
    record = json.loads((run / "config.json").read_text())
    record["command"] = ["shes", "train", "point-gather", "--out", str(run), f"--primitive={walker_run}", "--sigma=1"]
    (run / "config.json").write_text(json.dumps(record))
    ship(run, "gatherer", **TOLD, episodes=1, num_workers=1, into=tmp_path / "agents")
    folder = RunFolder.open(tmp_path / "agents" / "gatherer")
    text = folder.config.read_text()
    assert not {path for path in (tmp_path, walker_run) if str(path) in text}
    record = json.loads(text)
    assert record["command"] == ["shes", "train", "point-gather", "--out", "run", "--primitive=run", "--sigma=1"]
    assert record["config"]["transfer"]["primitive"] == record["primitive"]["run"] == "run"
    assert folder.load("best").numbers["primitive"] == "run"


def test_long_tables_are_thinned_and_rounded(run_copy, tmp_path):
    generations = range(1, 1001)
    rows = [f"{number},{number * 12345678},{number / 7!r},nan" for number in generations]
    for table in ("progress.csv", "evaluation.csv"):
        header = "generation,env_steps,wall_time_s,score_mean"
        (run_copy / table).write_text("\n".join([header, *rows]) + "\n")
    told = ship(run_copy, "long", **TOLD, checkpoint="2", episodes=1, num_workers=1, into=tmp_path / "agents")
    assert told.env_steps == 12345678000
    for table in ("progress.csv", "evaluation.csv"):
        columns = read_csv(tmp_path / "agents" / "long" / table)
        assert 290 <= len(columns["generation"]) <= 300
        assert {1, 2, 1000} <= set(columns["generation"])
        assert (columns["env_steps"] == 12345678 * columns["generation"]).all()
        assert columns["wall_time_s"][-1] == 142.857
        assert np.isnan(columns["score_mean"]).all()
