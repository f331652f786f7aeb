"""Every policy in `results/` is a run folder that every command takes; committed records are complete."""

import json
from pathlib import Path

import pytest

import shes
from shes.cli import main
from shes.runs.folder import RunFolder
from shes.runs.shipped import AGENTS

RESULTS = Path(__file__).parents[1] / "results"
CHECKPOINTS = sorted(RESULTS.glob("**/*.npz"))


def test_there_are_policies_and_no_other_arrays():
    assert CHECKPOINTS
    for file in CHECKPOINTS:
        assert file.parent.name == "checkpoints"
        assert RunFolder.open(file.parents[1]).load(file.stem).generation > 0


@pytest.mark.parametrize(
    "file", sorted((*RESULTS.rglob("config.json"), *AGENTS.rglob("config.json"))), ids=lambda file: file.parent.name
)
def test_the_record_of_every_committed_run_has_all_of_its_settings(file):
    folder = RunFolder(file.parent)
    assert folder.read_record()["config"] == folder.read_config().to_dict()


@pytest.mark.parametrize("run", sorted({file.parents[1] for file in CHECKPOINTS}), ids=lambda run: run.name)
def test_every_command_takes_a_committed_run(run, tmp_path, capsys):
    assert main(["evaluate", str(run), "--episodes", "1", "--workers", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episode_steps_mean"] > 0
    assert main(["info", str(run)]) == 0
    assert main(["plot", str(run), "--out", str(tmp_path / "curves.png")]) == 0
    assert main(["list", str(RESULTS)]) == 0
    assert run.name in capsys.readouterr().out
    assert shes.load(run).num_envs == 1
