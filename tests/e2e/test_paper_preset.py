"""A generation at the paper's size on every task of the ant."""

import math

import pytest

from shes.envs.named_environments import ENVIRONMENTS
from shes.runs.tables import read_csv
from tests.e2e import runs


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("env", [env for env in ENVIRONMENTS if env.startswith("ant-")])
def test_a_whole_generation_of_preset_paper(tmp_path, env):
    process = runs.start("train", env, "--preset", "paper", "--generations", "1", "--out", tmp_path / "run")
    _, err = process.communicate(timeout=3500)
    assert (process.returncode, err) == (0, "")
    row = {name: value for name, (value,) in read_csv(tmp_path / "run" / "progress.csv").items()}
    policies = 256 if env == "ant-flagrun" else 1000
    assert policies * 5 <= row["env_steps"] <= policies * 5 * 500
    assert all(math.isfinite(row[column]) for column in row if column.endswith("return_mean"))
    assert runs.state(tmp_path / "run").generation == 1
