"""Two samples of episodes are told apart where the physics differ, and only there."""

import math
from functools import partial

import numpy as np
import pytest

from benchmarks.device_check import ALPHA, POWER, compare_with_cpu, detectable_shift
from shes.envs.named_environments import ENVIRONMENTS
from shes.sim.simulator import CpuSimulator
from shes.sim.warp import WarpSimulator

SHORT = ("point-maze", "point-push", "ant-gather", "ant-push")


class Sluggish(CpuSimulator):
    """MuJoCo with only a share of the gear on every motor."""

    def __init__(self, model, num_sims, share):
        model.actuator_gear[:] *= share
        super().__init__(model, num_sims)


def differ(comparisons):
    """Return whether any p value of the comparisons is below the corrected threshold."""
    return min(min(each.p_shift, each.p_distance) for each in comparisons) < ALPHA / (2 * len(comparisons))


def test_the_power_is_as_stated():
    rng, n, trials = np.random.default_rng(0), 100, 2000
    shift = detectable_shift(n)
    found = 0
    for _ in range(trials):
        a, b = rng.normal(size=n), rng.normal(shift, 1, n)
        z = abs(a.mean() - b.mean()) / math.sqrt(a.var(ddof=1) / n + b.var(ddof=1) / n)
        found += math.erfc(z / math.sqrt(2)) < ALPHA
    assert found / trials == pytest.approx(POWER, abs=0.03)
    assert detectable_shift(1000) < 0.21 < detectable_shift(1000, tests=8) < 0.26


def test_other_seeds_on_the_same_simulator_are_not_told_apart():
    found = compare_with_cpu("point-maze", CpuSimulator, episodes=120, horizon=20)
    assert {c.measure for c in found} == {"environment return", "primitive return", "steps", "distance moved"}
    assert not differ(found)


@pytest.mark.parametrize(("share", "episodes"), [(0.75, 350), pytest.param(0.9, 2000, marks=pytest.mark.extras)])
def test_weaker_motors_are_found(share, episodes):
    found = compare_with_cpu("point-maze", partial(Sluggish, share=share), episodes=episodes, horizon=15)
    assert differ(found)


@pytest.mark.extras
@pytest.mark.parametrize("env", SHORT)
def test_warp_on_the_cpu_plays_the_same_game(env):
    # With 96 episodes the two sets of seeds differ by chance on ant-push (p 2e-5), the CPU against itself as well.
    found = compare_with_cpu(env, partial(WarpSimulator, device="warp-cpu"), episodes=160, horizon=40)
    assert not differ(found)


@pytest.mark.gpu
@pytest.mark.parametrize("spec", ["shes", "hiro"])
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_a_card_plays_the_same_game(env, spec):
    found = compare_with_cpu(env, partial(WarpSimulator, device="cuda"), spec=spec, episodes=1000)
    assert not differ(found)
