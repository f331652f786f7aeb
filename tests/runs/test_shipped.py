"""Shipped agents: named wherever a run folder may stand, made out of a run, never written into.

The agents of most tests are tiny ones; those that are really shipped are held to the contract at the end.
"""

import json
import shlex
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import shes
from experiments.ship import ship
from shes import cli
from shes.errors import CheckpointError, ConfigError, RunFolderError, UnknownNameError
from shes.runs import shipped
from shes.runs.checkpoint import load_checkpoint
from shes.runs.folder import RunFolder
from shes.runs.shipped import find_run, read_agent, shipped_name, shipped_names, shipped_path
from shes.runs.tables import read_csv
from shes.settings import setting_fields
from shes.training.build import build_task
from shes.training.evaluate import evaluate
from shes.training.make_config import make_config
from shes.viewing.plot import plot
from shes.viewing.render import render
from tests.e2e import runs

TOLD = {"description": "A point that walks.", "commands": ["shes train point-flagrun"]}
FILES = {"agent.json", "checkpoints", "config.json", "evaluation.csv", "progress.csv"}


@pytest.fixture(scope="module")
def walker_run(tmp_path_factory):
    """A run that trained a primitive alone. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("walker") / "run", "point-flagrun", hidden=(64,))


@pytest.fixture(scope="module")
def place(tmp_path_factory, tiny_run, walker_run):
    """A folder with two shipped agents. Not to be changed."""
    folder = tmp_path_factory.mktemp("shipped") / "agents"
    ship(walker_run, "point-walker", **TOLD, episodes=3, num_workers=1, into=folder)
    ship(tiny_run, "point-gather", **TOLD, episodes=3, seed=7, num_workers=1, into=folder)
    return folder


@pytest.fixture
def agents(place, tmp_path, monkeypatch):
    """The same as the package's own, from an empty working directory."""
    monkeypatch.setattr(shipped, "AGENTS", place)
    monkeypatch.chdir(tmp_path)
    return place


@pytest.fixture
def none_shipped(tmp_path, monkeypatch):
    monkeypatch.setattr(shipped, "AGENTS", tmp_path / "nowhere")
    monkeypatch.chdir(tmp_path)


# Names.


def test_a_name_is_found_and_a_path_wins_over_it(agents, run_copy):
    assert shipped_names() == ("point-gather", "point-walker")
    assert find_run("point-walker") == shipped_path("point-walker") == agents / "point-walker"
    assert find_run("./point-walker") == find_run(Path("./point-walker")) == Path("point-walker")
    assert RunFolder.open("point-gather").path == agents / "point-gather"
    run_copy.rename("point-gather")
    assert RunFolder.open("point-gather").path == Path("point-gather")


def test_what_is_no_name_is_refused_with_the_names(agents):
    message = (
        r"^point-wlker does not exist\. Give the folder .*\(its --out\)\. Or name a shipped agent: point-walker, poi"
    )
    with pytest.raises(RunFolderError, match=message + r".*\. Did you mean 'point-walker'\?$"):
        shes.load("point-wlker")
    with pytest.raises(RunFolderError, match=r"^point-walker does not exist\. .*\(its --out\)\.$"):
        shes.load("./point-walker")
    message = r"^point-walker does not exist\. .*A pathlib\.Path is always a path: .*give the string 'point-walker'\.$"
    with pytest.raises(RunFolderError, match=message):
        shes.load(Path("./point-walker"))
    with pytest.raises(RunFolderError, match=r"^point-walker does not exist\. .*\(its --out\)\.$"):
        runs.train_tiny(Path("run"), primitive=Path("./point-walker"))
    with pytest.raises(
        UnknownNameError, match=r"unknown shipped agent 'x'\. Known: point-gather, point-walker\. `shes"
    ):
        shipped_path("x")


def test_a_folder_that_hides_an_agent_is_refused_by_saying_so(agents):
    Path("point-walker").mkdir()
    with pytest.raises(RunFolderError, match=r"no config\.json\. .*It hides the shipped agent point-walker: rename it"):
        shes.load("point-walker")


def test_where_no_agent_is_shipped_nothing_is_said_of_them(none_shipped):
    assert shipped_names() == ()
    with pytest.raises(RunFolderError, match=r"^gone does not exist\. .*\(its --out\)\.$"):
        shes.load("gone")


# Use.


def test_a_shipped_agent_is_evaluated_loaded_and_drawn_by_name(agents, tiny_run):
    one, other = (evaluate(run, episodes=4, num_workers=1) for run in ("point-gather", tiny_run))
    assert one.summary() == other.summary()
    agent = shes.load("point-gather")
    assert agent.act(np.zeros(agent.observation_size)).shape == (2,)
    assert plot(["point-gather", "point-walker"]) == Path("curves.png")
    assert [path.name for path in Path().iterdir()] == ["curves.png"]


@pytest.mark.render
def test_a_video_of_a_shipped_agent_is_in_the_working_directory(agents):
    assert render("point-gather", steps=2, size=64) == Path("walk.mp4")
    assert [path.name for path in Path().iterdir()] == ["walk.mp4"]


def test_the_primitive_of_a_shipped_agent_is_brought_by_name(agents):
    path = runs.train_tiny(Path("run"), primitive="point-walker", generations=1)
    record = json.loads((path / "config.json").read_text())
    assert record["config"]["transfer"]["primitive"] == record["primitive"]["run"] == "point-walker"
    brought, own = (runs.state(run, "best").levels[-1] for run in ("point-walker", path))
    assert own.theta.tobytes() == brought.theta.tobytes()


def test_a_shipped_agent_has_its_best_checkpoint_alone(agents):
    with pytest.raises(CheckpointError, match=r"agent point-gather has only the checkpoint best, got 'last'\. Omit --"):
        evaluate("point-gather", checkpoint="last")
    with pytest.raises(CheckpointError, match=r"no checkpoint 'last'; it has best\. Omit --primitive-checkpoint"):
        runs.train_tiny(Path("run"), primitive="point-walker", primitive_checkpoint="last")


@pytest.mark.parametrize(("asked", "generation"), [("best", None), ("last", 4), ("2", 2)])
def test_another_checkpoint_than_the_best_can_be_shipped(tiny_run, tmp_path, asked, generation):
    told = ship(tiny_run, "other", **TOLD, checkpoint=asked, episodes=1, num_workers=1, into=tmp_path)
    shipped, own = (runs.state(path, name) for path, name in ((tmp_path / "other", "best"), (tiny_run, asked)))
    assert load_checkpoint(tmp_path / "other/checkpoints/best.npz").best.generation in (-1, told.generation)
    assert told.generation == shipped.generation == own.generation == (generation or own.generation)
    assert [level.theta.tobytes() for level in shipped.levels] == [level.theta.tobytes() for level in own.levels]


@pytest.mark.parametrize("by", ["name", "path"])
def test_nothing_is_written_into_a_shipped_agent(agents, by):
    run = "point-walker" if by == "name" else agents / "point-walker"
    with pytest.raises(RunFolderError, match=r"^point-walker is a shipped agent.*--primitive point-walker\. Or copy /"):
        shes.resume(run, generations=9)
    assert {path.name for path in (agents / "point-walker").iterdir()} == FILES


def test_a_copy_of_a_shipped_agent_can_be_trained_on(agents):
    shutil.copytree(agents / "point-gather", "mine")
    shutil.copy("mine/checkpoints/best.npz", "mine/checkpoints/last.npz")
    best = read_agent("point-gather").generation
    assert shes.resume("mine", generations=best + 1).generation == best + 1


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"commands": [], "evaluation": {}}', "without random"])
def test_a_damaged_agent_file_is_an_error_that_names_it(agents, tmp_path, monkeypatch, text):
    shutil.copytree(agents, "agents")
    monkeypatch.setattr(shipped, "AGENTS", tmp_path / "agents")
    file = tmp_path / "agents" / "point-gather" / "agent.json"
    if text == "without random":
        told = json.loads(file.read_text())
        del told["evaluation"]["random"]
        text = json.dumps(told)
    file.write_text(text)
    with pytest.raises(RunFolderError, match=r"agent\.json is damaged: .*Install SHES again"):
        read_agent("point-gather")


# What is really shipped.


def test_every_shipped_agent_is_small_complete_and_acts():
    for name in shipped_names():
        folder, told = RunFolder.open(shipped_path(name)), read_agent(name)
        assert {path.name for path in folder.path.iterdir()} == FILES
        assert [path.name for path in folder.checkpoints.iterdir()] == ["best.npz"]
        assert folder.checkpoint_path("best").stat().st_size < 200_000
        assert sum(path.stat().st_size for path in folder.path.rglob("*") if path.is_file()) < 500_000
        assert shipped_name(folder.path) == name
        assert folder.read_config().run.env == told.env
        assert folder.load("best").generation == told.generation
        assert told.description.strip()
        assert told.commands
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
                assert record["config"]["transfer"]["primitive"] == record["primitive"]["run"] == given
        agent, task = shes.load(shipped_path(name)), build_task(folder.read_config(), 1, is_evaluation=True)
        task.reset(np.array([0]), [1])
        control = agent.control(task.observe(), task.position, task.heading, task.goal)
        assert np.isfinite(control).all()
        task.step(np.array([0]), control)
        assert not task.diverged.any()
        task.close()


@pytest.mark.parametrize("name", shipped_names())
def test_the_last_command_of_a_shipped_agent_still_gives_the_settings_it_was_trained_with(name, monkeypatch):
    def train(env, *, preset, out, progress, **settings):
        asked.update(settings)
        raise ConfigError(f"{env} is not trained here")

    asked: dict[str, object] = {}
    monkeypatch.setattr("shes.training.train.train", train)
    assert cli.main(shlex.split(read_agent(name).commands[-1])[1:]) == 2
    trained = RunFolder.open(shipped_path(name)).read_config()
    levels = asked.keys() & trained.algorithm.transfers.keys()
    asked |= dict.fromkeys(levels, name) | dict.fromkeys((f"{level}_checkpoint" for level in levels), "best")
    gives, had = make_config(trained.run.env, overrides=asked).numbers(), trained.numbers()
    beside = {f"{level}{end}" for level in trained.algorithm.transfers for end in ("", "_checkpoint")}
    if trained.values["primitive"] and trained.values["freeze_primitive"]:
        beside |= {*setting_fields(type(trained.estimate))}  # how a primitive that is frozen would have learned
    assert {s: v for s, v in gives.items() if s not in beside} == {s: v for s, v in had.items() if s not in beside}
