"""On a card: `make test-gpu`. What the stand-in for CuPy and `warp-cpu` are held to elsewhere, with CuPy itself.

`SHES_TEST_DEVICE=warp-cpu` tries these tests without a card.
"""

import json
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.es.noise import NoiseTable, weighted_noise_sum
from shes.runs.folder import RunFolder
from shes.sim.simulator import CpuSimulator
from shes.sim.warp import WarpSimulator
from shes.sim.warp_device import WarpDevice
from shes.types import to_host
from tests.e2e import runs
from tests.envs.episodes import make_task
from tests.rollout import test_device_arrays as stand_in

pytestmark = [pytest.mark.gpu, pytest.mark.timeout(600)]

DEVICE = os.environ.get("SHES_TEST_DEVICE", "cuda")
SIMULATOR = partial(WarpSimulator, device=DEVICE)
# Feet touch the floor and the block of Push rests against walls: those agree with C mostly, not always.
IN_CONTACT = {"ant", "one-hot"}
TINY = {"preset": "smoke", "population_size": 16, "horizon": 20, "noise_table_size": 200_000}
TINY |= {"evaluation_episodes": 4, "evaluation_interval": 1}
EQUIVARIANT = {"controller_view": "sectors", "controller_output": "heading_direction", "primitive_view": "egocentric"}
HEXAPOD = Path(__file__).parents[2] / "examples" / "hexapod.xml"


@pytest.fixture(scope="module")
def xp():
    return WarpDevice(DEVICE).xp


def test_those_that_do_not_run_do_not_move():
    task = make_task("ant-gather", 8, simulator=SIMULATOR)
    task.reset(np.arange(8), list(range(8)))
    before = to_host(task.sim.qpos).copy()
    task.step(np.array([1, 5]), task.xp.full((8, task.action_size), 10, dtype=np.float32))
    moved = (to_host(task.sim.qpos) != before).any(axis=1)
    assert moved.tolist() == [i in {1, 5} for i in range(8)]


@pytest.mark.parametrize("name", sorted(stand_in.CHOICES.keys() - IN_CONTACT))
@pytest.mark.parametrize("episodes", [1, 3])
def test_a_generation_has_the_numbers_of_the_cpu(name, episodes, xp):
    found, _ = stand_in.run(name, SIMULATOR, 8, xp, episodes)
    expected, _ = stand_in.run(name, CpuSimulator, 8, episodes=episodes)
    assert found.keys() == expected.keys()
    for number, result in found.items():
        mine, other = result.outcomes, expected[number].outcomes
        assert mine["steps"].tolist() == other["steps"].tolist()
        np.testing.assert_allclose(mine["returns"], other["returns"], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(mine["final_position"], other["final_position"], atol=1e-3)


def test_the_weighted_sum_of_noise_has_the_bits_of_the_cpu(xp):
    rng = np.random.default_rng(0)
    table = NoiseTable(rng.standard_normal(1_000_000, dtype=np.float32))
    index, weights = rng.integers(0, 800_000, 300), rng.normal(size=300).astype(np.float32)
    on_device = weighted_noise_sum(table.on(xp), index, weights, 150_000)
    assert on_device.tobytes() == weighted_noise_sum(table, index, weights, 150_000).tobytes()


@pytest.mark.parametrize(
    ("env", "settings"),
    [
        ("ant-gather", {"controller_network": "equivariant", "primitive_estimate": "interval", **EQUIVARIANT}),
        ("ant-push", {"explore": "archive", "primitive_view": "egocentric"}),
        ("gather", {"robot": HEXAPOD}),
    ],
)
def test_a_run_goes_from_the_cpu_to_the_card_and_back(env, settings, tmp_path):
    run = tmp_path / "run"
    shes.train(env, out=run, generations=2, backend="serial", **TINY, **settings)
    shes.resume(run, generations=4, device=DEVICE)
    shes.resume(run, generations=5, device="cpu")
    record = json.loads((run / "config.json").read_text())
    assert [part["device"]["name"] for part in (record, *record["resumed"])] == ["cpu", DEVICE, "cpu"]
    assert RunFolder.open(run).load("last").generation == 5


@pytest.mark.parametrize("env", ["ant-gather", "ant-push"])
def test_deterministic_runs_are_bit_identical(env, tmp_path):
    """Feet touch the ground all the time, and the block of Push has box-box contacts. Also after a resume."""
    one, again, resumed = (tmp_path / name for name in ("one", "again", "resumed"))
    settings = {**TINY, "population_size": 64, "horizon": 60, "device": DEVICE, "deterministic": True}
    for path, generations in ((one, 3), (again, 3), (resumed, 2)):
        shes.train(env, out=path, generations=generations, **settings)
    shes.resume(resumed, generations=3)
    assert [runs.differences(one, other) for other in (again, resumed)] == [[], []]


def test_a_population_in_parts_is_the_same_population(tmp_path):
    thetas = []
    for chunk_size in (0, 4):
        run = tmp_path / str(chunk_size)
        shes.train("point-gather", out=run, generations=1, device=DEVICE, chunk_size=chunk_size, **TINY)
        thetas.append(runs.state(run, "last").levels[0].theta)
    np.testing.assert_allclose(*thetas, atol=1e-3)
