"""Every policy in `results/` is a run folder that can be read and acts; committed records are complete."""

import json
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.runs.folder import RunFolder
from shes.runs.shipped import AGENTS
from shes.viewing.playback import Playback

RESULTS = Path(__file__).parents[1] / "results"
CHECKPOINTS = sorted(RESULTS.glob("**/*.npz"))


@pytest.mark.parametrize(
    "file", sorted((*RESULTS.rglob("config.json"), *AGENTS.rglob("config.json"))), ids=lambda file: file.parent.name
)
def test_the_record_of_a_committed_run_has_all_of_its_settings(file):
    folder = RunFolder(file.parent)
    assert folder.read_record()["config"] == folder.read_config().to_dict()


@pytest.mark.parametrize("run", sorted({file.parents[1] for file in CHECKPOINTS}), ids=lambda run: run.name)
def test_a_committed_run_is_read_and_acts(run, capsys):
    assert main(["info", str(run), "--json"]) == 0
    # A run that has only begun has no best checkpoint yet.
    state, name = ("finished", "best") if (run / "checkpoints/best.npz").exists() else ("stopped", "last")
    assert json.loads(capsys.readouterr().out)["state"] == state
    assert np.isfinite((agent := shes.load(run, checkpoint=name)).act(np.zeros(agent.observation_size))).all()
    folder = RunFolder.open(run)
    assert all(folder.load(file.stem).generation > 0 for file in folder.checkpoints.iterdir())
    assert next(Playback(run, name).play(0)).facts[0] == f"after {folder.load(name).generation} generations"
