"""The runs of an experiment: ordinary ones that go on where they were stopped; those that fail or do not fit."""

import os
import shutil
import signal
import sys
from dataclasses import replace
from functools import partial

import psutil
import pytest

from experiments.results import SUMMARY, read_results, read_summary, write_tables
from experiments.running import check_experiment, finish, run_experiment, runs_left, side_by_side
from experiments.summary import provenance_columns, summarise
from shes.baselines.td3 import LEARNING
from shes.errors import ConfigError, MissingExtraError, RunFolderError, UnknownNameError, WorkerError
from shes.machine import core_numbers
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from tests.e2e import runs
from tests.experiments.tiny import FAILING, experiment, run, without_times
from tests.messages import raises


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


def made(out, *members, is_large=True, **options):
    """Make the runs of an experiment, in this process if they are large; return the errors, and results by name."""
    chosen = experiment(*members, has_large_runs=is_large)
    failed = run_experiment(chosen, out, say=lambda _: None, **{"backend": "serial", "num_workers": 1, **options})
    return failed, {name: without_times(each) for name, each in read_results(chosen, out).items()}


def test_a_run_is_an_ordinary_one_and_a_row(finished, tiny_run):
    path, summary = finished / run().name, read_summary(run(), finished)
    assert runs.differences(tiny_run, path) == []
    found, row = evaluate(path, episodes=3, checkpoint="last").summary(), summary.row
    assert [row[name] for name in ("group", "variant", "env", "seed")] == ["choices", "base", "point-gather", 5]
    assert (row["generations"], row["env_steps"], row["workers"]) == (4, 4 * 8 * 20, 1)
    assert (row["last_score"], row["last_return"]) == (found["score_mean"], found["return_mean"])
    assert [point["env_steps"] for point in summary.curve] == [160, 320, 640]
    progress, evaluation = (read_csv(path / f"{name}.csv") for name in ("progress", "evaluation"))
    returns = progress["controller_return_mean"]
    means = [returns[0], returns[1], sum(returns[2:]) / 2]  # since the evaluation before
    assert [point["training_return_mean"] for point in summary.curve] == pytest.approx(means)
    assert row["seconds"] == progress["process_time_s"][-1]  # the time of a run in one process is the processor's
    assert [point["seconds"] for point in summary.curve] == evaluation["process_time_s"].tolist()


def test_the_time_of_a_run_of_several_processes_is_the_walls(copy, finished, monkeypatch):
    folder = RunFolder(copy / run().name)
    record = folder.read_record()
    record["config"]["workers"] |= {"backend": "processes", "num_workers": 2}
    folder.write_record(record)
    monkeypatch.setattr("experiments.summary.evaluate", lambda _, **given: evaluate(finished / run().name, **given))
    row = summarise(run(), copy, 3).row
    assert (row["workers"], row["seconds"]) == (2, read_csv(folder.progress)["wall_time_s"][-1])


@pytest.mark.parametrize("has_more", [True, False])
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not(copy, finished, has_more):
    """A finished one is not made again."""
    folder = RunFolder(copy / run().name)
    if has_more:  # killed after the second generation; else after the last one, and then it is not trained again
        shutil.copy(folder.checkpoint_path(2), folder.checkpoint_path("last"))
    before = folder.progress.read_bytes()
    finish(run(), copy, 3)
    assert without_times(read_summary(run(), copy)) == without_times(read_summary(run(), finished))
    assert runs.differences(finished / run().name, folder.path) == []
    assert (folder.progress.read_bytes() == before) is not has_more
    written = (copy / run().name / SUMMARY).stat()
    finish(run(), copy, 3)
    assert (copy / run().name / SUMMARY).stat() == written


def test_a_run_of_other_settings_is_refused_and_named(copy):
    other = run(sigma=0.5)
    match = "seed-5 holds a run of other settings than ... /seed-5, such as another --scale: sigma is 0.07, not 0.5"
    for go_on in (lambda: check_experiment(experiment(other), copy), lambda: finish(other, copy, 3)):
        with raises(RunFolderError, match):
            go_on()


def test_a_time_limit_of_a_run_counts_all_of_its_parts(tmp_path):
    limited = run(minutes=1e-3, generations=100_000)
    finish(limited, tmp_path, 1)
    generations = read_summary(limited, tmp_path).row["generations"]
    assert 1 <= generations < 1000
    (tmp_path / limited.name / SUMMARY).unlink()
    shorter = run(minutes=1e-4, generations=100_000)  # it has been trained for longer
    finish(shorter, tmp_path, 1)
    assert read_summary(shorter, tmp_path).row["generations"] == generations


def test_what_cannot_be_run_shows_before_anything_is(tmp_path, finished, monkeypatch):
    out, of_hiro = tmp_path / "out", replace(run("hiro"), settings={"algorithm": "hiro"})
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, LEARNING, raising=False)  # else what another test has imported is there already
    for member, error, options in (
        (run("b", population_size=7), ConfigError, {}),
        (run(), UnknownNameError, {"backend": "rays"}),
        (of_hiro, MissingExtraError, {}),
    ):
        with pytest.raises(error):
            made(out, member, **options)
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(MissingExtraError):
        made(out, run())
    assert not out.exists()
    monkeypatch.undo()
    with pytest.raises(RunFolderError):
        made(finished / run().name, run())


def test_a_primitive_is_made_before_what_takes_it(tmp_path, monkeypatch):
    source = run(env="point-flagrun", group="transfer")
    taker = run("frozen", group="transfer", primitive=source, freeze_primitive=True)
    assert made(tmp_path / "a", source)[0] == {}
    failed, found = made(tmp_path / "a", taker, source, backend="processes")
    assert (failed, list(found)) == ({}, [source.name, taker.name])
    assert RunFolder(tmp_path / "a" / taker.name).read_config().workers.backend == "processes"
    one = runs.state(tmp_path / "a" / source.name, "best").levels[0]
    other = runs.state(tmp_path / "a" / taker.name, "last").levels[1]
    assert (one.name, one.theta.tobytes()) == (other.name, other.theta.tobytes())
    summary, before = read_summary(taker, tmp_path / "a"), read_summary(source, tmp_path / "a").row
    for name in ("env_steps", "seconds"):
        assert {row[f"primitive_{name}"] for row in summary.curve} == {before[name]}
    (tmp_path / "a").rename(tmp_path / "b")
    monkeypatch.chdir(tmp_path)
    check_experiment(experiment(taker, source), tmp_path / "b")
    # From the tables alone, the primitive is trained again: what begins with it needs more than its row.
    chosen, second = experiment(source, run(), taker), tmp_path / "second"
    results = read_results(experiment(source, taker), tmp_path / "b")
    second.mkdir()
    write_tables(chosen, {source.name: results[source.name]}, second)
    assert [each.name for each in runs_left(chosen, second)] == [source.name, run().name, taker.name]


def test_runs_side_by_side_have_the_same_numbers_and_fail_alone(tmp_path, finished):
    bad = run("bad", **FAILING)
    taker = run("taker", primitive=bad)
    failed, found = made(tmp_path, taker, run(), bad, is_large=False)
    assert failed.keys() == {bad.name, taker.name}
    assert "noise_table_size is 3" in failed[bad.name]
    assert failed[taker.name] == "the run of its primitive failed"
    assert found == {run().name: without_times(read_summary(run(), finished))}
    assert (tmp_path / "runs.csv").is_file()


def note_cores(place, each):
    """Note the cores of this process; stands in for a run. One is killed, as for lack of memory."""
    (place / each).write_text(repr(psutil.Process().cpu_affinity()))
    if each == "killed":
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be kept on a core here")
def test_a_process_keeps_to_a_core_and_ends_all_if_killed(tmp_path):
    cores = core_numbers()
    one = partial(note_cores, tmp_path)
    assert list(side_by_side(one, len(cores), ["pinned"])) == [("pinned", "")]
    assert (tmp_path / "pinned").read_text() in {f"[{core}]" for core in cores}
    with raises(WorkerError, "a process that made runs has died, maybe for lack of memory"):
        list(side_by_side(one, max(1, len(cores) - 1), ["killed"]))
    assert (tmp_path / "killed").read_text() == (f"{cores}" if len(cores) > 1 else f"[{cores[0]}]")


def test_the_origin_of_a_run_is_named_once_for_its_parts():
    machine, versions = {"system": "Linux", "processor": "Zen", "cores": 24}, {"python": "3.12.1", "numpy": "2.4"}
    part = {"machine": machine, "device": {"name": "cpu"}, "versions": versions, "git_commit": "12345678"}
    other = {**part, "git_commit": "9abcdef0", "device": {"name": "cuda", "model": "H100"}}
    assert provenance_columns([part, other, part]) == {
        "hardware": "Zen, 24 cores; Zen, 24 cores, name cuda, model H100",
        "versions": "python 3.12.1, numpy 2.4",
        "commit": "12345678; 9abcdef0",
    }
    assert provenance_columns([{}])["commit"] is None
