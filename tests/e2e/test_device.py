"""Runs on mujoco-warp, on the CPU: by the command line, in turns with MuJoCo in C, and when something is too small."""

import json
import shutil

import numpy as np
import pytest

import shes
from shes.errors import ConfigError
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.sim.warp_device import load_warp
from tests.e2e import runs
from tests.sim import test_warp

pytestmark = test_warp.pytestmark

ANT = {"env": "ant-gather", "episodes_per_policy": 2, "generations": 2, "device": "warp-cpu"}
"""Every test has the ant's kernels: they are compiled once."""


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A run on warp-cpu. Not to be changed: copy it."""
    return runs.train_tiny(tmp_path_factory.mktemp("device") / "run", **ANT)


@pytest.mark.parametrize("chunk_size", [1, 3])
def test_the_number_of_policies_in_lockstep_changes_no_number(walked, tmp_path, chunk_size):
    assert runs.differences(walked, runs.train_tiny(tmp_path / "run", **ANT, chunk_size=chunk_size)) == []


def test_deterministic_runs_repeat_and_their_models_say_so(walked, tmp_path, monkeypatch):
    """Box-box contacts of Push included. Additions on the CPU are in a fixed order without it."""
    mujoco_warp, models = load_warp()[1], []
    put_model = mujoco_warp.put_model
    monkeypatch.setattr(mujoco_warp, "put_model", lambda model: models.append(put_model(model)) or models[-1])
    push = {**ANT, "env": "ant-push", "generations": 1, "deterministic": True}
    one, again = (runs.train_tiny(tmp_path / name, **push) for name in ("one", "again"))
    assert {model.opt.deterministic for model in models} == {mujoco_warp.DeterminismType.ALL}
    assert runs.differences(one, again) == []
    models.clear()
    shes.evaluate(walked, episodes=2, device="warp-cpu")
    assert {model.opt.deterministic for model in models} == {0}


def test_a_run_that_was_interrupted_goes_on_as_if_it_had_not(walked, tmp_path):
    path = runs.train_tiny(tmp_path / "run", **{**ANT, "generations": 1})
    shes.resume(path, generations=2)
    assert runs.differences(walked, path) == []


def test_a_run_goes_to_a_device_and_back_as_its_record_says(tmp_path):
    path = runs.train_tiny(tmp_path / "run", "ant-gather", generations=2, evaluation_interval=1)
    for device, generations in (("warp-cpu", 4), ("cpu", 5)):
        code, out, err = runs.run("resume", path, "--device", device, "--generations", generations)
        assert (code, err) == (0, ""), out
        assert f"-> {device}" in out
    record = json.loads((path / "config.json").read_text())
    assert record["device"] == {"name": "cpu"}
    parts = [(part["generation"], part["device"]["name"]) for part in record["resumed"]]
    assert parts == [(2, "warp-cpu"), (4, "cpu")]
    assert set(record["resumed"][0]["device"]) == {"name", "mujoco-warp", "warp-lang"}
    rows = read_csv(path / "progress.csv")
    assert rows["generation"].tolist() == [1, 2, 3, 4, 5]
    assert all(np.isfinite(rows["controller_return_mean"]))
    assert RunFolder.open(path).load("last").generation == 5


def test_a_full_buffer_ends_a_run_that_goes_on_with_a_larger_one(walked, tmp_path):
    path = shutil.copytree(walked, tmp_path / "run")
    code, out, err = runs.run("resume", path, "--generations", 3, "--nconmax", 1)
    assert code == 2, out
    assert err.count("\n") == 1
    assert "contact buffer overflowed" in err
    *_, name, _, size = err.split()
    assert name == "--nconmax"
    code, out, err = runs.run("resume", path, name, size.rstrip("."))
    assert (code, err) == (0, ""), out
    assert RunFolder.open(path).load("last").generation == 3


def test_cuda_where_there_is_no_card_is_one_line_and_no_folder(tmp_path):
    if load_warp()[0].get_cuda_device_count():
        pytest.skip("there is a card")
    with pytest.raises(ConfigError):
        shes.train("ant-gather", device="cuda", out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
