"""Breaking the physics must not pay, though it ends an episode: where every step costs, that would be the best way."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import shes
from shes.envs.named_environments import EXTERNAL_ENVIRONMENTS
from shes.errors import DivergenceError
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.recorder import Divergence
from shes.runs.tables import read_csv
from tests.e2e import runs

STEPS = 20
TINY = {**runs.TINY, "horizon": STEPS, "evaluation_horizon": STEPS, "evaluation_interval": 1, "keep_checkpoints": 1}


class Fog(gymnasium.Env):
    """Its reward is NaN."""

    observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    action_space = Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        return np.zeros(3), {}

    def step(self, action):
        return np.zeros(3), float("nan"), False, False, {}


class Glass(gymnasium.Env):
    """Every step costs 1 and a little for the distance gone; who pushes too hard to the right sees NaN from then on."""

    observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    action_space = Box(-1, 1, (2,), np.float32)

    def __init__(self, breaks_at=0.0, render_mode=None):
        self.breaks_at, self.render_mode = breaks_at, render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1, 1, 3)
        return self.place.copy(), {}

    def step(self, action):
        self.place[:2] += 0.01 * action
        cost = 1 + abs(float(action[1])) / 10
        seen = self.place.copy() if action[0] <= self.breaks_at else np.full(3, np.nan)
        return seen, -cost, False, False, {}


@pytest.fixture(scope="module", autouse=True)
def registries():
    """The registries with the glass in them, as it is and in two other kinds; afterwards all is forgotten."""
    before = dict(EXTERNAL_ENVIRONMENTS)
    for name, breaks_at in (("glass", 0.0), ("steel", 2.0), ("dust", -2.0)):
        shes.register_external(name, partial(Glass, breaks_at), locate=lambda seen, _: (seen[0], seen[1], 0.0))
    shes.register_external("fog", Fog, locate=lambda seen, _: (seen[0], seen[1], 0.0))
    yield
    EXTERNAL_ENVIRONMENTS.clear()
    EXTERNAL_ENVIRONMENTS.update(before)


@pytest.fixture(scope="module", params=["shes", "es"])
def glass(request, tmp_path_factory, registries):
    """A run in which some episodes diverge and others do not."""
    path = tmp_path_factory.mktemp(request.param) / "run"
    return runs.train_tiny(path, "glass", **{**TINY, "population_size": 40, "sigma": 0.3}, algorithm=request.param)


def test_no_member_earns_more_than_the_worst_of_those_that_stay_whole(glass):
    """Undivided, a step before the end costs 1 to 1.1: all that broke would rank above all that did not."""
    table = read_csv(glass / "progress.csv")
    assert all(0 < rate < 1 for rate in table["diverged_rate"])
    assert all(mean < STEPS for mean in table["episode_steps_mean"])
    level = "policy" if "policy_return_max" in table else "controller"
    assert max(table[f"{level}_return_mean"]) <= max(table[f"{level}_return_max"]) <= -STEPS
    broken, worst = np.array(table["diverged_rate"]), 1 / 40  # all that broke, and the one that they share the rank of
    np.testing.assert_allclose(table[f"{level}_rank_ties"], broken + worst)


@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_a_reward_that_is_nan_is_told_at_once_and_ends_the_run_with_its_likely_cause(tmp_path, algorithm):
    told = []
    listener = type("Ear", (), {"on_event": lambda _, event: told.append(event)})()
    message = (
        r"every episode of the last 10 generations diverged\. Likely cause: a reward or an observation of fog is NaN .*"
        r"Everything up to the last checkpoint is kept\."
    )
    settings = {**TINY, "generations": 12, "evaluation_interval": 12, "algorithm": algorithm}
    with pytest.raises(DivergenceError, match=message) as caught:
        runs.train_tiny(tmp_path / "run", "fog", **settings, listener=listener)
    assert caught.value.exit_code == 1
    text = (
        "all 8 episodes of generation {} diverged (physics, observation or reward not finite): nothing can be learned"
    )
    warnings = [text.format(generation) + " from it" for generation in range(1, 11)]
    of_evaluation = "all 3 episodes of the evaluation diverged: its score does not count"
    assert told == [warnings[0], of_evaluation, *warnings[1:]]
    assert RunFolder.open(tmp_path / "run").load("last").generation == 10
    assert set(told) <= set(runs.log_lines(tmp_path / "run"))


def test_one_sound_generation_begins_the_count_anew():
    count = Divergence("fog")
    for generation, rate in enumerate([1] * 9 + [0.9] + [1] * 9 + [0] + [1] * 9, 1):
        row = {"generation": generation, "diverged_rate": rate, "diverged_episodes": round(8 * rate)}
        assert (count.add(row) is not None) == (rate == 1)
        count.check(is_over=False)
    count.check(is_over=True)  # not all was in vain
    count.add(row)
    with pytest.raises(DivergenceError, match="last 10 generations"):
        count.check(is_over=False)


def test_returns_of_another_algorithm_that_are_nan_count_too():
    count = Divergence("fog")
    assert count.add({"generation": 7, "policy_return_mean": 0.0}) is None
    for generation in range(8, 18):
        count.check(is_over=False)
        told = count.add({"generation": generation, "policy_return_mean": float("nan")})
        assert told == f"no return of generation {generation} is finite: nothing can be learned from it"
    with pytest.raises(DivergenceError):
        count.check(is_over=False)


def set_bias(run, push, slope=0.0):
    """Write checkpoint `best` of a flat run without hidden layers: it pushes right by `push`, plus `slope` times x."""
    path = RunFolder.open(run).checkpoint_path("best")
    with np.load(path) as file:
        arrays = dict(file)
    theta = np.zeros((4, 2), np.float32)  # three observations and the bias, two actions
    theta[3, 0], theta[0, 0] = push, slope
    arrays["policy/theta"] = theta.ravel()
    arrays["policy/observation_count"] = np.int64(0)
    np.savez(path, **arrays)


def test_an_evaluation_that_diverges_does_not_beat_one_that_does_not(tmp_path):
    flat = {**TINY, "generations": 1, "algorithm": "es", "hidden": ()}
    run = runs.train_tiny(tmp_path / "run", "glass", **flat)
    found = {}
    for name, push, slope in (("whole", -1, 0), ("some", 0, 1), ("all", 1, 0)):
        set_bias(run, push, slope)
        found[name] = evaluate(run, episodes=12, num_workers=1)
    assert found["whole"].diverged.sum() == 0
    assert 0 < found["some"].diverged.sum() < 12
    assert found["all"].diverged.sum() == 12
    whole, some = found["whole"].summary(), found["some"].summary()
    assert some["score_mean"] <= whole["score_mean"] == -STEPS
    assert some["return_mean"] <= whole["return_mean"] == -STEPS
    assert some["score_std"] == some["return_std"] == 0  # which says nothing better of the broken ones
    assert some["episode_steps_mean"] < STEPS
    assert some["diverged_episodes"] == found["some"].diverged.sum()


@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_an_evaluation_in_which_everything_broke_is_never_the_best(tmp_path, algorithm):
    """Its score, 0 for each broken episode, is above all scores of whole ones."""
    run = tmp_path / "dust"
    with pytest.raises(DivergenceError, match="last 4 generations"):
        runs.train_tiny(run, "dust", **TINY, algorithm=algorithm)
    assert set(read_csv(run / "evaluation.csv")["diverged_episodes"]) == {3}
    assert RunFolder.open(run).load("last").best.generation == -1
    assert RunFolder.open(run).load("best").generation == 0
    whole = runs.train_tiny(tmp_path / "steel", "steel", **TINY, algorithm=algorithm)
    assert RunFolder.open(whole).load("last").best.generation >= 1
