"""A generation at the paper's size on every task of the ant."""

import csv
import math

import pytest

from shes.envs.named_environments import ENVIRONMENTS
from tests.e2e import runs


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("env", [env for env in ENVIRONMENTS if env.startswith("ant-")])
def test_a_whole_generation_of_preset_paper(tmp_path, env):
    process = runs.start("train", env, "--preset", "paper", "--generations", "1", "--out", tmp_path / "run")
    _, err = process.communicate(timeout=3500)
    assert (process.returncode, err) == (0, "")
    with (tmp_path / "run" / "progress.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    policies = 256 if env == "ant-flagrun" else 1000
    assert policies * 5 <= int(row["env_steps"]) <= policies * 5 * 500
    assert all(math.isfinite(float(row[column])) for column in row if column.endswith("return_mean"))
    assert runs.state(tmp_path / "run").generation == 1
