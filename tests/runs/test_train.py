"""Training: which evaluation is the best one, and what is kept of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from shes.errors import ConfigError
from shes.runs import session
from shes.runs.evaluate import Evaluation
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.runs.train import resume
from tests.e2e import runs


@pytest.fixture
def find(monkeypatch):
    """Return a function that makes the evaluations of generations 1, 2 and 4 find these (score, return)."""

    def prepare(*found):
        left = list(found)

        def evaluate(*arguments):
            score, mean_return = left.pop(0)
            zeros = np.zeros(2)
            found = Evaluation(
                scores=zeros + score,
                returns=zeros + mean_return,
                primitive_returns=zeros,
                goals_reached=zeros,
                successes=zeros,
                steps=zeros,
                diverged=zeros,
            )
            return SimpleNamespace(is_done=True, result=lambda: found)

        monkeypatch.setattr(session, "EvaluationBeside", evaluate)

    return prepare


@pytest.mark.parametrize(
    ("found", "best"),
    [
        ([(1, 0), (3, 0), (2, 0)], 2),
        ([(3, 0), (2, 9), (1, 9)], 1),
        ([(1, 0), (2, 0), (3, 0)], 4),
        ([(3, 5), (3, 4), (0, 0)], 1),  # a tie goes to the higher return
        ([(3, 5), (3, 5), (0, 0)], 2),  # then to the later one
        ([(-3, 0), (-2, 0), (-9, 0)], 2),
    ],
)
def test_the_best_evaluation_is_kept(tmp_path, find, found, best):
    find(*found)
    path = runs.train_tiny(tmp_path / "run")
    folder = RunFolder.open(path)
    assert folder.load("last").best.generation == best
    kept = folder.load("best")
    assert kept.generation == best
    assert kept.best.generation == best
    if best != 1:  # every second generation is kept
        one, other = (runs.state(path, name).levels[0].theta for name in ("best", best))
        assert one.tobytes() == other.tobytes()


def test_the_best_evaluation_is_remembered_over_a_resume(tmp_path, find):
    find((3, 0), (1, 0))
    path = runs.train_tiny(tmp_path / "run", generations=2)
    find((2, 0))
    assert resume(path, generations=4).best.generation == 1
    assert RunFolder.open(path).load("best").generation == 1


def test_before_the_first_evaluation_the_best_is_the_start(tmp_path):
    path = runs.train_tiny(tmp_path / "run", minutes=1e-9)
    folder = RunFolder.open(path)
    assert folder.load("best").generation == 0
    assert folder.load("last").best.generation == -1


def test_a_run_ends_with_the_generation_that_reaches_its_environment_steps(tmp_path):
    whole = runs.train_tiny(tmp_path / "whole")  # 4 generations of 160 steps
    path = runs.train_tiny(tmp_path / "run", env_steps=161)
    state = runs.state(path, "last")
    assert (state.generation, state.env_steps) == (2, 320)
    with pytest.raises(ConfigError, match=r"made 320 environment steps, but --env-steps is 161\. .*--env-steps 640"):
        resume(path)
    assert resume(path, env_steps=10_000).generation == 4
    assert runs.differences(whole, path) == []


BRANCHES = {
    "primitive_estimate": "interval",
    "primitive_view": "proprioception",
    "controller_interval": 5,
    "primitive_population_size": 8,
}


@pytest.mark.parametrize("settings", [{}, BRANCHES], ids=["episodes", "branches"])
def test_a_row_begins_with_the_steps_that_the_generation_made_and_the_time_that_it_took(tmp_path, settings):
    path = runs.train_tiny(tmp_path / "run", evaluation_interval=100, **settings)
    table = {name: np.array(values) for name, values in read_csv(path / "progress.csv").items()}
    assert list(table)[:4] == ["generation", "env_steps", "wall_time_s", "env_steps_per_s"]
    assert table["generation"].tolist() == [1, 2, 3, 4]
    assert table["env_steps"][-1] == runs.state(path, "last").env_steps
    seconds = np.diff(table["env_steps"], prepend=0) / table["env_steps_per_s"]
    assert (seconds >= 0.999 * (table["rollout_s"] + table["update_s"]) - 1e-3).all()
    apart = np.diff(table["wall_time_s"], prepend=0)[1:] - table["evaluation_s"][:-1]
    np.testing.assert_allclose(seconds[1:], apart, atol=0.01, rtol=0.01)


class _Heard:
    """A listener that remembers what was unusual."""

    def __init__(self):
        self.events = []

    def on_event(self, event):
        self.events.append(event)

    def on_start(self, *told):
        pass

    on_generation = on_evaluation = on_start


FALLING = {"sigma_schedule": "linear", "sigma_end": 0.01}


BRANCHES = {"primitive_view": "egocentric", "primitive_estimate": "interval", "controller_interval": 4, "horizon": 8}
SHORT = "the schedules take 1000 generations, but the run ends after 1, short of their end: see --schedule-generations"
WARNINGS = [
    ({}, ()),
    (FALLING, (SHORT,)),
    ({**BRANCHES, "intervals": 2}, ()),
    ({**BRANCHES, "intervals": 3}, ("a branch has 12 steps, more than an episode (8): see --intervals",)),
]


@pytest.mark.parametrize(("settings", "told"), WARNINGS)
def test_a_run_warns_of_its_settings_when_it_begins(tmp_path, settings, told):
    heard = _Heard()
    path = runs.train_tiny(tmp_path / "run", generations=1, listener=heard, **settings)
    assert heard.events == [*told]
    log = (path / "log.txt").read_text()
    assert all(warning in log for warning in told)
    on = _Heard()
    resume(path, generations=2, listener=on)
    assert len(on.events) == len(told)


def test_a_run_as_long_as_its_schedule_says_nothing_of_it(tmp_path):
    heard = _Heard()
    settings = {"learning_rate_schedule": "cosine", "learning_rate_end": 0, "schedule_generations": 2}
    path = runs.train_tiny(tmp_path / "run", generations=3, listener=heard, **settings)
    assert heard.events == []
    before, after = (runs.state(path, name).levels[0].theta for name in ("2", "last"))
    assert before.tobytes() == after.tobytes()  # nothing is learnt at a rate of zero


def test_a_run_whose_workers_cannot_start_leaves_nothing(tmp_path, monkeypatch):
    def refuse(*_):
        raise ConfigError("no cluster")

    old = runs.train_tiny(tmp_path / "old", generations=1)
    record = RunFolder(old).config.read_bytes()
    monkeypatch.setattr("shes.runs.train.build_backend", refuse)
    with pytest.raises(ConfigError, match="no cluster"):
        runs.train_tiny(tmp_path / "new")
    with pytest.raises(ConfigError, match="no cluster"):
        resume(old, generations=2)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    assert RunFolder(old).config.read_bytes() == record
