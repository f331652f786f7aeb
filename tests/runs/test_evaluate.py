"""Evaluation: fresh episodes of the mean policies, the same on any number of workers."""

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest

from shes.algorithms.evolution.strategies import EvolutionAlgorithm
from shes.errors import CheckpointError, PolicyError, RunFolderError, UnknownNameError
from shes.es.streams import Purpose
from shes.runs.evaluate import Evaluation, evaluate, evaluation_seeds, fresh_seeds
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from tests.e2e import runs

ARRAYS = ("scores", "returns", "primitive_returns", "goals_reached", "successes", "steps", "diverged")


def same(one, other):
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ARRAYS)


@pytest.fixture(scope="module")
def threes(tmp_path_factory):
    """A run with three episodes per policy, so that blocks of evaluation are not full."""
    return runs.train_tiny(
        tmp_path_factory.mktemp("threes") / "run", episodes_per_policy=3, backend="processes", num_workers=1
    )


def test_workers_change_no_number(threes):
    one = evaluate(threes, episodes=7, num_workers=1)
    assert same(one, evaluate(threes, episodes=7, num_workers=2))
    assert one.scores.shape == (7,)


@pytest.mark.parametrize("backend", ["mpi", "ray"])
def test_a_run_of_a_cluster_is_evaluated_on_this_machine(run_copy, tiny_run, backend):
    record = json.loads((run_copy / "config.json").read_text())
    record["config"]["workers"] |= {"backend": backend}
    if backend == "ray":
        record["config"]["workers"] |= {"ray_address": "gone:6379"}
    (run_copy / "config.json").write_text(json.dumps(record))
    assert same(evaluate(run_copy, episodes=4, num_workers=1), evaluate(tiny_run, episodes=4, num_workers=1))


def test_what_the_workers_tell_is_a_warning(tiny_run, monkeypatch, caplog):
    def build(*arguments):
        backend = original(*arguments)
        all_at_once = backend.map
        monkeypatch.setattr(
            backend, "map", lambda tasks: (backend.on_event("worker 7 gives no answer"), all_at_once(tasks))[1]
        )
        return backend

    module = importlib.import_module("shes.runs.evaluate")
    original = module.build_backend
    monkeypatch.setattr(module, "build_backend", build)
    evaluate(tiny_run, episodes=2, num_workers=1)
    assert [(each.levelname, each.message) for each in caplog.records] == [("WARNING", "worker 7 gives no answer")]


def test_fewer_episodes_are_the_first_of_more(tiny_run):
    few, many = (evaluate(tiny_run, episodes=episodes, num_workers=1) for episodes in (3, 5))
    for name in ARRAYS:
        assert np.array_equal(getattr(few, name), getattr(many, name)[:3])


def test_a_seed_chooses_other_episodes(tiny_run):
    default, one, again, two = (evaluate(tiny_run, episodes=4, seed=seed) for seed in (None, 1, 1, 2))
    assert same(one, again)
    assert not same(one, two)
    assert not same(default, one)


def test_targets_of_training_may_be_asked_for(tmp_path):
    # Training's target is far: nobody comes nearer than 200 m to it, or further than 50 m from evaluation's.
    run = runs.train_tiny(tmp_path / "run", "point-maze", target=(0.0, 300.0), evaluation_target=(0.0, 1.0))
    one, other = (evaluate(run, episodes=4, num_workers=1, targets=targets) for targets in ("evaluation", "training"))
    assert other.returns.max() < 20 * -200
    assert one.returns.min() > 20 * -50
    assert same(one, evaluate(run, episodes=4, num_workers=1))
    with pytest.raises(UnknownNameError, match=r"unknown targets 'train'.*Did you mean 'training'.*Set --targets"):
        evaluate(run, targets="train")


def test_the_targets_of_training_come_without_its_falls(tmp_path):
    run = runs.train_tiny(tmp_path / "run", "ant-maze", max_tilt=0.5)
    assert np.mean(read_csv(run / "progress.csv")["terminated_rate"]) > 0.5
    found = evaluate(run, episodes=3, num_workers=1, targets="training")
    assert set(found.steps) == {RunFolder(run).read_config().episodes.horizon}


def test_checkpoints_are_evaluated_apart(tiny_run):
    assert not same(evaluate(tiny_run, episodes=4, checkpoint="0"), evaluate(tiny_run, episodes=4, checkpoint="last"))
    assert same(evaluate(tiny_run, episodes=4, checkpoint="4"), evaluate(tiny_run, episodes=4, checkpoint="last"))


def test_fresh_episodes_are_none_of_those_that_chose_the_checkpoint(tiny_run):
    state = runs.state(tiny_run, "last")
    chosen = evaluation_seeds(state.seed, state.generation, 50)
    fresh = fresh_seeds(state, 50)
    assert len({*chosen, *fresh}) == 100
    assert evaluation_seeds(state.seed, state.generation, 50) == chosen
    assert fresh == evaluation_seeds(state.seed, state.generation, 50, Purpose.FRESH_EPISODES)


def test_a_seed_of_ones_own_gives_the_same_episodes_whatever_the_checkpoint(tiny_run):
    one, other = (fresh_seeds(runs.state(tiny_run, name), 50, seed=3) for name in ("0", "last"))
    assert one == other
    assert not {*one} & {*fresh_seeds(runs.state(tiny_run, "last"), 50)}


def test_every_generation_is_evaluated_on_other_episodes(tiny_run):
    seeds = [evaluation_seeds(5, generation, 50) for generation in (0, 2, 4)]
    assert len({seed for row in seeds for seed in row}) == 150


def test_training_evaluates_the_policies_that_it_stores(tiny_run):
    """The last row of the table is the last checkpoint on the seeds of that generation."""
    folder = RunFolder.open(tiny_run)
    table = read_csv(folder.evaluation)
    assert table["generation"][-1] == 4
    best = folder.load("last").best
    row = table["generation"].index(best.generation)
    ranked = sorted(zip(table["score_mean"], table["return_mean"], table["generation"], strict=True))
    assert ranked[-1] == (best.score, best.mean_return, best.generation)
    assert (table["score_mean"][row], table["return_mean"][row]) == (best.score, best.mean_return)
    assert folder.load("best").generation == best.generation


def test_a_summary_holds_means_and_deviations():
    found = Evaluation(
        scores=np.array([0.0, 4.0]),
        returns=np.array([-1.0, 3.0]),
        primitive_returns=np.array([5.0, 6.0]),
        goals_reached=np.array([2.0, 1.0]),
        successes=np.array([0.0, 1.0]),
        steps=np.array([10.0, 20.0]),
        diverged=np.array([1.0, 0.0]),
    )
    assert found.summary() == {
        "episodes": 2,
        "score_mean": 2.0,
        "score_std": 2.0,
        "return_mean": 1.0,
        "return_std": 2.0,
        "primitive_return_mean": 5.5,
        "goals_reached_mean": 1.5,
        "success_rate": 0.5,
        "episode_steps_mean": 15.0,
        "diverged_episodes": 1,
    }


@pytest.mark.parametrize(
    ("env", "settings", "has_primitive"),
    [("point-gather", {"algorithm": "es"}, False), ("point-flagrun", {}, True)],
)
def test_a_run_of_one_level_is_evaluated_by_what_it_has(tmp_path, env, settings, has_primitive):
    path = runs.train_tiny(tmp_path / "run", env, generations=1, **settings)
    found = evaluate(path, episodes=3, num_workers=1)
    assert (found.primitive_returns is not None) is has_primitive
    of_primitive = {name for name in found.summary() if name.startswith(("primitive", "goals"))}
    assert of_primitive == ({"primitive_return_mean", "goals_reached_mean"} if has_primitive else set())
    assert found.returns.shape == found.scores.shape == (3,)
    table = read_csv(path / "evaluation.csv")
    assert set(found.summary()) == set(table) - {"generation", "env_steps", "wall_time_s", "process_time_s"}


def test_a_primitive_alone_is_paid_as_flagrun_pays(tmp_path):
    """The task pays by the same formula, in code of its own."""
    path = runs.train_tiny(tmp_path / "run", "point-flagrun", generations=1, controller_interval=7)
    found = evaluate(path, episodes=3, num_workers=1)
    np.testing.assert_allclose(found.primitive_returns, found.returns, rtol=1e-9)


def test_evaluation_has_its_own_horizon(tmp_path):
    path = runs.train_tiny(tmp_path / "run", evaluation_horizon=30, generations=1)
    assert evaluate(path, episodes=2).steps.tolist() == [30, 30]
    assert read_csv(path / "progress.csv")["episode_steps_mean"] == [20]
    assert read_csv(path / "evaluation.csv")["episode_steps_mean"] == [30]


def test_evaluation_writes_nothing(run_copy):
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    evaluate(run_copy, episodes=2)
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before


def test_wrong_arguments_are_refused(tiny_run, tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        evaluate(tmp_path)
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*There are: best, generation_000000, "):
        evaluate(tiny_run, checkpoint="first")


def test_a_policy_that_is_nan_is_refused_before_it_acts(run_copy):
    path = run_copy / "checkpoints" / "best.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays["primitive/theta"][3] = np.nan
    np.savez(path, **arrays)
    with pytest.raises(CheckpointError, match=r"best\.npz holds NaN or infinity in primitive/theta\. Take an earlier"):
        evaluate(run_copy, episodes=2)


def test_a_policy_that_returns_nan_is_an_error(run_copy, monkeypatch):
    """Where it comes from nobody knows: the checkpoint itself holds none."""

    def parameters(learner, state):
        controller, primitive = original(learner, state)
        return controller, replace(primitive, theta=np.full_like(primitive.theta, np.nan))

    original = EvolutionAlgorithm.parameters
    monkeypatch.setattr(EvolutionAlgorithm, "parameters", parameters)
    with pytest.raises(PolicyError, match=r"returned NaN or infinity at step 0 \(parameters of its primitive"):
        evaluate(run_copy, episodes=2)
