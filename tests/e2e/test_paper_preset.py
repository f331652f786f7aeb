"""A generation at the paper's size on every task of the ant."""

import math

import pytest

import shes
from shes.envs.named_environments import ENVIRONMENTS


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("env", [env for env in ENVIRONMENTS if env.startswith("ant-")])
def test_a_whole_generation_of_preset_paper(tmp_path, env):
    run = shes.train(env, preset="paper", generations=1, out=tmp_path / "run")
    row = {name: value for name, (value,) in run.progress.items()}
    policies = 256 if env == "ant-flagrun" else 1000
    assert policies * 5 <= row["env_steps"] <= policies * 5 * 500
    assert all(math.isfinite(row[column]) for column in row if column.endswith("return_mean"))
