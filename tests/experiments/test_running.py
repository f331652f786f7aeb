"""The runs of an experiment: ordinary ones that go on where they were stopped; those that fail or do not fit."""

import os
import shutil
import signal
import sys
from dataclasses import replace
from functools import partial

import psutil
import pytest

from experiments import running
from experiments.results import SUMMARY, read_results, read_summary, write_tables
from experiments.running import check_experiment, finish, run_experiment, runs_left
from experiments.summary import provenance_columns
from shes.errors import ConfigError, MissingExtraError, RunFolderError, UnknownNameError, WorkerError
from shes.machine import core_numbers
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.experiments.tiny import FAILING, experiment, run, without_times

ONE = experiment(run())


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Folder of an experiment with one finished run. Not to be changed."""
    out = tmp_path_factory.mktemp("experiment")
    finish(run(), out, 3)
    return out


@pytest.fixture
def copy(finished, tmp_path):
    """The same without its summary, to be changed."""
    shutil.copytree(finished, tmp_path / "copy")
    (tmp_path / "copy" / run().name / SUMMARY).unlink()
    return tmp_path / "copy"


def made(out, *members, **options):
    """Make the runs of an experiment; return the errors, and the results by name without times."""
    chosen = experiment(*members)
    failed = run_experiment(chosen, out, say=lambda _: None, **options)
    return failed, {name: without_times(each) for name, each in read_results(chosen, out).items()}


# One run.


def test_a_run_is_an_ordinary_one_and_a_row(finished, tiny_run):
    path, summary = finished / run().name, read_summary(run(), finished)
    assert runs.differences(tiny_run, path) == []
    found, row = evaluate(path, episodes=3, checkpoint="last").summary(), summary.row
    assert [row[name] for name in ("group", "variant", "env", "seed")] == ["choices", "base", "point-gather", 5]
    assert (row["generations"], row["env_steps"], row["workers"]) == (4, 4 * 8 * 20, 1)
    assert (row["last_score"], row["last_return"]) == (found["score_mean"], found["return_mean"])
    assert [point["env_steps"] for point in summary.curve] == [160, 320, 640]
    progress = read_csv(path / "progress.csv")
    returns = progress["controller_return_mean"]
    means = [returns[0], returns[1], sum(returns[2:]) / 2]  # since the evaluation before
    assert [point["training_return_mean"] for point in summary.curve] == pytest.approx(means)


def test_the_time_of_a_run_in_one_process_is_the_processors(finished):
    summary = read_summary(run(), finished)
    progress, evaluation = (read_csv(finished / run().name / f"{name}.csv") for name in ("progress", "evaluation"))
    assert summary.row["seconds"] == progress["process_time_s"][-1]
    assert [row["seconds"] for row in summary.curve] == evaluation["process_time_s"]


def test_a_finished_run_is_not_made_again(finished, monkeypatch):
    monkeypatch.setattr(running, "finish_run", None)
    finish(run(), finished, 3)


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not(finished, tmp_path):
    shutil.copytree(finished / run().name, tmp_path / run().name)
    folder = RunFolder(tmp_path / run().name)
    (folder.path / SUMMARY).unlink()
    shutil.copy(folder.checkpoint_path(2), folder.checkpoint_path("last"))  # killed after the second generation
    finish(run(), tmp_path, 3)
    assert without_times(read_summary(run(), tmp_path)) == without_times(read_summary(run(), finished))
    assert runs.differences(finished / run().name, folder.path) == []


def test_a_run_without_a_summary_alone_is_not_trained_again(copy, finished):
    before = (copy / run().name / "progress.csv").read_bytes()
    finish(run(), copy, 3)
    assert read_summary(run(), copy) == read_summary(run(), finished)
    assert (copy / run().name / "progress.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("other", "what"),
    [({"sigma": 0.5}, r"sigma is 0\.07 there, not 0\.5"), ({"generations": 9}, "generations is 4 there, not 9")],
)
def test_a_run_of_other_settings_is_refused_and_named(copy, other, what):
    match = rf"seed-5 holds a run of other settings than \S+/seed-5, such as another --scale: {what}"
    with pytest.raises(RunFolderError, match=match):
        check_experiment(experiment(run(**other)), copy)
    with pytest.raises(RunFolderError, match=match):
        finish(run(**other), copy, 3)


def test_a_time_limit_of_a_run_counts_all_of_its_parts(tmp_path):
    limited = run(minutes=1e-3, generations=100_000)
    finish(limited, tmp_path, 1)
    generations = read_summary(limited, tmp_path).row["generations"]
    assert 1 <= generations < 1000
    (tmp_path / limited.name / SUMMARY).unlink()
    shorter = run(minutes=1e-4, generations=100_000)  # it has been trained for longer
    finish(shorter, tmp_path, 1)
    assert read_summary(shorter, tmp_path).row["generations"] == generations


# All runs.


def test_what_cannot_be_run_shows_before_anything_is(tmp_path, finished, monkeypatch):
    out = tmp_path / "out"
    hiro = replace(run("hiro"), settings={"algorithm": "hiro"})
    cases = [
        (run("b", population_size=7), ConfigError, "population_size must be a positive multiple of 4", {}),
        (run(), UnknownNameError, "'rays'", {"backend": "rays"}),
        (hiro, MissingExtraError, "--algorithm hiro needs JAX", {}),
        (run(), MissingExtraError, "needs SciPy", {}),
    ]
    monkeypatch.setitem(sys.modules, "jax", None)
    for name in [each for each in sys.modules if each.startswith("shes.baselines.")]:
        monkeypatch.delitem(sys.modules, name)  # else what another test has imported is there already
    for member, error, words, options in cases:
        if "SciPy" in words:
            monkeypatch.setitem(sys.modules, "scipy", None)
        with pytest.raises(error, match=words):
            made(out, member, **options)
    assert not out.exists()
    monkeypatch.undo()
    with pytest.raises(RunFolderError, match="is a run folder: several runs need a folder of their own"):
        made(finished / run().name, run())


def test_a_primitive_is_made_before_what_takes_it_wherever_the_folder_lies(tmp_path, monkeypatch):
    source = run(env="point-flagrun", group="transfer")
    taker = run("frozen", group="transfer", primitive=source, freeze_primitive=True)
    failed, found = made(tmp_path / "a", taker, source, num_workers=2)
    assert (failed, list(found)) == ({}, [source.name, taker.name])
    one = runs.state(tmp_path / "a" / source.name, "best").levels[0]
    other = runs.state(tmp_path / "a" / taker.name, "last").levels[1]
    assert (one.name, one.theta.tobytes()) == (other.name, other.theta.tobytes())
    summary, before = read_summary(taker, tmp_path / "a"), read_summary(source, tmp_path / "a").row
    assert {row["primitive_env_steps"] for row in summary.curve} == {before["env_steps"]}
    assert {row["primitive_seconds"] for row in summary.curve} == {before["seconds"]}
    (tmp_path / "a").rename(tmp_path / "b")
    monkeypatch.chdir(tmp_path)
    check_experiment(experiment(taker, source), tmp_path / "b")


def test_a_run_that_fails_stops_only_what_takes_its_primitive(tmp_path, finished):
    bad = run("bad", **FAILING)
    taker = run("taker", primitive=bad)
    failed, found = made(tmp_path, taker, run(), bad, num_workers=2)
    assert failed.keys() == {bad.name, taker.name}
    assert "noise_table_size is 3" in failed[bad.name]
    assert failed[taker.name] == "the run of its primitive failed"
    assert found == {run().name: without_times(read_summary(run(), finished))}
    assert (tmp_path / "runs.csv").is_file()


def test_large_runs_have_all_workers_and_the_same_numbers(tmp_path, finished):
    chosen = experiment(run(), has_large_runs=True)
    assert run_experiment(chosen, tmp_path, say=lambda _: None, num_workers=2) == {}
    summary = read_summary(run(), tmp_path)
    assert without_times(summary) == without_times(read_summary(run(), finished))
    assert summary.row["workers"] == 2
    assert summary.row["seconds"] == read_csv(tmp_path / run().name / "progress.csv")["wall_time_s"][-1]


@pytest.mark.extras
def test_an_experiment_goes_on_from_its_tables_alone(tmp_path):
    source = run(env="point-flagrun", group="transfer")
    taker = run("frozen", group="transfer", primitive=source, freeze_primitive=True)
    chosen, second = experiment(source, run(), taker), tmp_path / "second"
    _, whole = made(tmp_path / "first", *chosen.runs, num_workers=1)
    results = read_results(chosen, tmp_path / "first")
    second.mkdir()
    write_tables(chosen, {name: each for name, each in results.items() if name != taker.name}, second)
    # The primitive is trained again: what begins with it needs more than its row.
    assert [each.name for each in runs_left(chosen, second)] == [source.name, taker.name]
    assert made(second, *chosen.runs, num_workers=1) == ({}, whole)
    assert runs_left(chosen, second) == []


def affinity(place, each):
    """Note the cores of this process; stands in for a run."""
    (place / f"{os.getpid()}").write_text(repr(psutil.Process().cpu_affinity()))


def die(each):
    """Stands in for a run whose process is killed, as by a system whose memory has run out."""
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be kept on a core here")
def test_each_process_keeps_to_a_core_if_all_are_used(tmp_path):
    cores = core_numbers()
    members = [run(seed=seed) for seed in range(4 * len(cores))]
    for count in (len(cores), len(cores) - 1):
        place = tmp_path / f"{count}"
        place.mkdir()
        ended = running._side_by_side(partial(affinity, place), max(1, count), members)
        assert {each.name: error for each, error in ended} == {each.name: "" for each in members}
        found = {file.read_text() for file in place.iterdir()}
        assert found <= ({f"[{core}]" for core in cores} if count >= len(cores) else {f"{cores}"})


def test_a_process_that_is_killed_ends_the_experiment():
    with pytest.raises(WorkerError, match="a process that made runs has died, maybe for lack of memory"):
        list(running._side_by_side(die, 1, [run()]))


# Provenance.


def test_the_origin_of_a_run_is_named_once_for_its_parts():
    part = {
        "machine": {"system": "Linux", "processor": "Zen", "cores": 24},
        "device": {"name": "cpu"},
        "versions": {"python": "3.12.1", "numpy": "2.4"},
        "git_commit": "12345678",
    }
    other = {**part, "git_commit": "9abcdef0", "device": {"name": "cuda", "model": "H100"}}
    assert provenance_columns([part, other, part]) == {
        "hardware": "Zen, 24 cores; Zen, 24 cores, name cuda, model H100",
        "versions": "python 3.12.1, numpy 2.4",
        "commit": "12345678; 9abcdef0",
    }
    assert provenance_columns([{}])["commit"] is None
