"""Breaking the physics must not pay, though it ends an episode: where every step costs, that would be the best way."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import shes
from shes.errors import DivergenceError
from shes.runs.folder import RunFolder
from shes.runs.recorder import Divergence
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.envs.external_envs import registered
from tests.messages import raises

STEPS = 20
TINY = {**runs.TINY, "horizon": STEPS, "evaluation_horizon": STEPS, "evaluation_interval": 1, "keep_checkpoints": 1}


class Glass(gymnasium.Env):
    """Every step costs a little more for the distance gone; who pushes too hard to the right sees NaN from then on."""

    observation_space = Box(-np.inf, np.inf, (3,), np.float64)
    action_space = Box(-1, 1, (2,), np.float32)

    def __init__(self, breaks_at=0.0, cost=1.0, render_mode=None):
        self.breaks_at, self.cost, self.render_mode = breaks_at, cost, render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-1, 1, 3)
        return self.place.copy(), {}

    def step(self, action):
        self.place[:2] += 0.01 * action
        cost = self.cost + abs(float(action[1])) / 10
        seen = self.place.copy() if action[0] <= self.breaks_at else np.full(3, np.nan)
        return seen, -cost, False, False, {}


@pytest.fixture(scope="module", autouse=True)
def registries():
    """The registries with the glass in them, as it is and in three other kinds; afterwards all is forgotten."""
    with registered():
        for name, *made in (("glass", 0.0), ("steel", 2.0), ("dust", -2.0), ("fog", 2.0, np.nan)):
            shes.register_external(name, partial(Glass, *made), locate=lambda seen, _: (seen[0], seen[1], 0.0))
        yield


@pytest.fixture(scope="module", params=["shes", "es"])
def glass(request, tmp_path_factory, registries):
    """A run in which some episodes diverge and others do not."""
    path = tmp_path_factory.mktemp(request.param) / "run"
    return runs.train_tiny(path, "glass", **{**TINY, "population_size": 40, "sigma": 0.3}, algorithm=request.param)


def test_no_member_earns_more_than_the_worst_whole_one(glass):
    """Undivided, a step before the end costs 1 to 1.1: all that broke would rank above all that did not."""
    table = read_csv(glass / "progress.csv")
    assert all(0 < rate < 1 for rate in table["diverged_rate"])
    assert all(mean < STEPS for mean in table["episode_steps_mean"])
    level = "policy" if "policy_return_max" in table else "controller"
    assert max(table[f"{level}_return_mean"]) <= max(table[f"{level}_return_max"]) <= -STEPS
    broken, worst = np.array(table["diverged_rate"]), 1 / 40  # all that broke, and the one that they share the rank of
    np.testing.assert_allclose(table[f"{level}_rank_ties"], broken + worst)


@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_a_reward_that_is_nan_is_told_and_ends_the_run(tmp_path, algorithm):
    told = []
    listener = type("Ear", (), {"on_event": lambda _, event: told.append(event)})()
    message = (
        "every episode of the last 10 generations diverged. Likely cause: a reward or an observation of fog is NaN ... "
        "Everything up to the last checkpoint is kept."
    )
    settings = {**TINY, "generations": 12, "evaluation_interval": 12, "algorithm": algorithm}
    with raises(DivergenceError, message) as caught:
        runs.train_tiny(tmp_path / "run", "fog", **settings, listener=listener)
    assert caught.value.exit_code == 1
    cause = "diverged (physics, observation or reward not finite): nothing can be learned from it"
    warnings = [f"every episode of generation {generation} {cause}" for generation in range(1, 11)]
    of_evaluation = "all 3 episodes of the evaluation diverged: its score does not count"
    assert told == [warnings[0], of_evaluation, *warnings[1:]]
    assert RunFolder.open(tmp_path / "run").load("last").generation == 10
    assert set(told) <= set(runs.log_lines(tmp_path / "run"))


@pytest.mark.parametrize(
    ("broken", "sound"),
    [({"diverged_rate": 1}, {"diverged_rate": 0.9}), ({"policy_return_mean": np.nan}, {"policy_return_mean": 0.0})],
)
def test_one_sound_generation_begins_the_count_anew(broken, sound):
    count = Divergence("fog")
    for generation, row in enumerate([*([broken] * 9 + [sound]) * 2, *[broken] * 9], 1):
        assert (count.add({"generation": generation, **row}) is not None) == (row is broken)
        count.check(is_over=False)
    count.check(is_over=True)  # not all was in vain
    assert count.add({"generation": 30, **broken}) is not None
    with pytest.raises(DivergenceError):
        count.check(is_over=False)


def test_a_broken_episode_counts_as_the_worst_whole_one(glass):
    found = shes.evaluate(glass, episodes=12, num_workers=1, checkpoint="0")
    broken = found.diverged == 1
    assert 0 < broken.sum() == found.summary()["diverged_episodes"] < 12
    for values in (found.scores, found.returns):
        assert set(values[broken]) == {values[~broken].min()}
        assert values.max() <= -STEPS
    assert found.steps[broken].max() < STEPS


@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_an_evaluation_where_everything_broke_is_never_the_best(tmp_path, algorithm):
    """Its score, 0 for each broken episode, is above all scores of whole ones."""
    run = tmp_path / "dust"
    with pytest.raises(DivergenceError, match="last 4 generations"):
        runs.train_tiny(run, "dust", **TINY, algorithm=algorithm)
    assert set(read_csv(run / "evaluation.csv")["diverged_episodes"]) == {3}
    assert RunFolder.open(run).load("last").best.generation == -1
    assert RunFolder.open(run).load("best").generation == 0
    whole = runs.train_tiny(tmp_path / "steel", "steel", **TINY, algorithm=algorithm)
    assert RunFolder.open(whole).load("last").best.generation >= 1
