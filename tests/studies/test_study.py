"""Studies: order of the cells, resumption, cells that fail; what the studies consist of, and their statistics."""

import csv
import itertools
import math
import shutil
import signal
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from shes.algorithms.presets import PRESETS, Preset
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.errors import ConfigError, MissingExtraError, RunFolderError, UnknownNameError
from shes.runs import recorder
from shes.runs import train as training
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.studies import ablation as ablations
from shes.studies import paper_scales as papers
from shes.studies import running, walker_study
from shes.studies.comparison import compare
from shes.studies.design import STEPS_PER_S, Curves, Measure, StudyDesign, sweep_name
from shes.studies.experiment import experiment, forecast, with_progress
from shes.studies.named_studies import STUDIES
from shes.studies.running import check_study, run_cell, run_study
from shes.studies.significance import (
    check_scipy,
    holm,
    interquartile_mean,
    mann_whitney,
    permutation_test,
    superiority,
)
from shes.studies.study import Study, cell_config, cell_steps, choose, generation_steps
from shes.studies.study_tables import Cell, CellResults, read_tables, write_tables
from shes.studies.summaries import cells_left, read_summaries, read_summary, write_summary
from shes.training.make_config import make_config
from tests.e2e import runs
from tests.studies.workers import MortalWorker

TINY = {name: value for name, value in runs.TINY.items() if name not in ("preset", "seed", "backend")}
MADE = {name: cache(make) for name, make in STUDIES.items()}
"""The functions that make the studies, each of which makes the same study once: the learning study takes a second."""
ablation, learning = MADE["ablation"], MADE["learning"]
FAILING = {**TINY, "noise_table_size": 3}  # allowed, but no level fits: it shows when the run begins


def cell(variant="base", seed=5, env="point-gather", group="choices", primitive=None, settings=TINY):
    return Cell(
        group=group, variant=variant, env=env, seed=seed, settings=settings, primitive=primitive, preset="smoke"
    )


def rows(path):
    """Return a table's rows without time and workers."""
    with path.open(newline="") as file:
        return [
            {name: value for name, value in row.items() if name not in ("seconds", "workers")}
            for row in csv.DictReader(file)
        ]


def without_seconds(summary):
    """Return a summary without what depends on the execution."""
    times = dict.fromkeys(("seconds", "primitive_seconds"), 0)
    curve = tuple({**row, **times} for row in summary.curve)
    return replace(summary, row={**summary.row, "seconds": 0, "workers": 0}, curve=curve)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Folder of a study with one finished cell, and its summary. Not to be changed."""
    out = tmp_path_factory.mktemp("study")
    return out, run_cell(cell(), out, 3)


# A study.


def test_seeds_come_first_and_a_primitive_before_what_begins_with_it():
    alone = [cell("a", seed) for seed in (1, 2)] + [cell("b", seed) for seed in (1, 2)]
    first = [cell("primitive", seed) for seed in (1, 2)]
    after = [cell("after", seed, primitive=first[seed - 1]) for seed in (1, 2)]
    stages = Study(cells=(*alone, *after, *first)).stages()
    assert [[(c.variant, c.seed) for c in stage] for stage in stages] == [
        [("primitive", 1), ("primitive", 2)],
        [("a", 1), ("b", 1), ("after", 1), ("a", 2), ("b", 2), ("after", 2)],
    ]


def test_a_chain_of_primitives_has_a_stage_for_every_link():
    first = cell("first")
    second = cell("second", primitive=first)
    third = cell("third", primitive=second)
    assert Study(cells=(third, second, first)).stages() == ((first,), (second,), (third,))


def test_cells_of_one_name_and_primitives_of_no_cell_are_refused():
    with pytest.raises(ConfigError, match="two cells of the study are called point-gather/choices/base/seed-5"):
        Study(cells=(cell(), cell(settings={})))
    with pytest.raises(
        ConfigError,
        match="begins with the primitive of point-gather/choices/nowhere/seed-5, which is not a cell of the study",
    ):
        Study(cells=(cell(primitive=cell("nowhere")),))


def test_steps_of_a_cell_are_those_of_training_and_of_every_evaluation():
    # 4 generations of 8 members; after generations 1, 2 and 4 three episodes; then 10 each, thrice.
    assert cell_steps(cell(), 10) == (20 * 4 * 8, 20 * (3 * 3 + 3 * 10))
    unfrozen = cell(primitive=cell("other"), settings={**TINY, "freeze_primitive": False})
    assert cell_steps(unfrozen, 10) == cell_steps(cell(), 10)  # no run is needed to know


# A cell.


def test_a_cell_is_an_ordinary_run_and_a_row(finished, tiny_run):
    out, summary = finished
    path = out / "point-gather" / "choices" / "base" / "seed-5"
    assert runs.differences(tiny_run, path) == []
    found = evaluate(path, episodes=3, checkpoint="last").summary()
    row = summary.row
    assert [row[name] for name in ("group", "variant", "env", "seed")] == ["choices", "base", "point-gather", 5]
    assert (row["generations"], row["env_steps"]) == (4, 4 * 8 * 20)
    assert (row["last_score"], row["last_return"]) == (found["score_mean"], found["return_mean"])
    assert row["last_steps"] == found["episode_steps_mean"]
    assert row["best_goals_reached"] >= 0
    assert [point["env_steps"] for point in summary.curve] == [160, 320, 640]


def test_a_finished_cell_is_not_run_again(finished, monkeypatch):
    for name in ("start_run", "resume_run", "summarise"):
        monkeypatch.setattr(running, name, None)
    out, summary = finished
    assert run_cell(cell(), out, 3) == summary


def test_a_cell_that_was_stopped_goes_on_as_if_it_had_not(finished, tmp_path, monkeypatch):
    evaluations = []

    def evaluate(*arguments):
        evaluations.append(arguments)
        if len(evaluations) == 2:
            signal.raise_signal(signal.SIGINT)
        return original(*arguments)

    original = recorder.evaluate_state
    monkeypatch.setattr(recorder, "evaluate_state", evaluate)
    with pytest.raises(KeyboardInterrupt):
        run_cell(cell(), tmp_path, 3)
    assert read_summaries(Study(cells=(cell(),)), tmp_path) == {}
    monkeypatch.undo()
    whole, summary = finished
    assert without_seconds(run_cell(cell(), tmp_path, 3)) == without_seconds(summary)
    assert runs.differences(whole / cell().name, tmp_path / cell().name) == []


def test_a_cell_whose_evaluation_alone_is_missing_is_not_trained_again(finished, tmp_path, monkeypatch):
    shutil.copytree(finished[0], tmp_path / "copy")
    (tmp_path / "copy" / cell().name / "summary.json").unlink()
    monkeypatch.setattr(running, "resume_run", None)
    assert run_cell(cell(), tmp_path / "copy", 3) == finished[1]


@pytest.mark.parametrize(
    ("other", "what"),
    [({"sigma": 0.5}, r"sigma is 0\.07 there, not 0\.5"), ({"generations": 9}, "generations is 4 there")],
)
def test_a_folder_with_a_run_of_other_settings_is_refused_and_named(finished, other, what):
    changed = cell(settings={**TINY, **other})
    match = rf"seed-5 holds a run of other settings than cell \S+/seed-5, such as another --scale: {what}"
    with pytest.raises(RunFolderError, match=match):
        check_study(Study(cells=(changed,)), finished[0])
    with pytest.raises(RunFolderError, match="of other settings"):
        next(run_study(Study(cells=(changed,)), finished[0], num_workers=1))


def test_results_of_other_settings_are_refused_and_named(finished, tmp_path):
    """Those of figure 6 have no run folder."""
    write_summary(cell(), tmp_path, finished[1])
    assert read_summary(cell(), tmp_path) == finished[1]
    primitive = cell("primitive")
    for other in (cell(settings={**TINY, "sigma": 0.5}), cell(primitive=primitive)):
        with pytest.raises(
            RunFolderError, match=r"seed-5 holds results of other settings than cell .* another --scale"
        ):
            read_summaries(Study(cells=(other, primitive)), tmp_path)


def test_a_row_does_not_stand_for_a_run_on_a_primitive_of_other_settings(finished, tmp_path):
    begun, other = (cell(primitive=cell("primitive", settings={**TINY, "sigma": sigma})) for sigma in (0.07, 0.5))
    write_tables([begun], {begun.name: finished[1]}, tmp_path)
    assert list(read_tables([begun], tmp_path)) == [begun.name]
    assert read_tables([other], tmp_path) == {}
    assert (
        cell(seed=1, primitive=cell("primitive", seed=1)).digest
        == cell(seed=2, primitive=cell("primitive", seed=2)).digest
    )


def test_the_folder_of_a_run_is_no_place_for_a_study(finished):
    with pytest.raises(RunFolderError, match="is a run folder: several runs need a folder of their own"):
        check_study(Study(cells=()), finished[0] / cell().name)


def test_settings_that_are_not_allowed_show_before_anything_is_run(tmp_path):
    study = Study(cells=(cell(), cell("b", settings={**TINY, "population_size": 7})))
    with pytest.raises(ConfigError, match="population_size must be a positive multiple of 4"):
        next(run_study(study, tmp_path, num_workers=1))
    assert [path.name for path in tmp_path.iterdir()] == []


def test_a_damaged_summary_says_what_to_do(finished, tmp_path):
    copy = shutil.copytree(finished[0], tmp_path / "copy")
    (copy / cell().name / "summary.json").write_text("{")
    with pytest.raises(RunFolderError, match=r"summary.json cannot be read: .*Remove it to have it made again"):
        read_summaries(Study(cells=(cell(),)), copy)


def test_tables_have_a_row_for_every_run_and_every_evaluation(finished, tmp_path):
    write_tables([cell()], {cell().name: finished[1]}, tmp_path)
    (row,) = rows(tmp_path / "runs.csv")
    assert {name: row[name] for name in ("variant", "env", "seed", "generations")} == {
        "variant": "base",
        "env": "point-gather",
        "seed": "5",
        "generations": "4",
    }
    assert float(row["best_return"]) == finished[1].row["best_return"]
    curve = rows(tmp_path / "curves.csv")
    assert [float(point["env_steps"]) for point in curve] == [160, 320, 640]
    assert float(curve[2]["return_mean"]) == finished[1].curve[2]["return_mean"]


def test_tables_are_read_back_as_they_were_written(finished, tmp_path, monkeypatch):
    write_tables([cell()], {cell().name: finished[1]}, tmp_path)
    assert read_tables([cell()], tmp_path) == {cell().name: finished[1]}
    assert read_summaries(Study(cells=(cell(),)), tmp_path) == {cell().name: finished[1]}
    for other in (cell(settings={**TINY, "sigma": 0.5}), cell(seed=6), cell(variant="other")):
        assert read_tables([other], tmp_path) == {}
    monkeypatch.setitem(PRESETS, "smoke", Preset(values={**PRESETS["smoke"].values, "horizon": 123}))
    assert read_tables([cell()], tmp_path) == {cell().name: finished[1]}  # it sets the horizon itself
    monkeypatch.setitem(PRESETS, "smoke", Preset(values={**PRESETS["smoke"].values, "sigma": 0.123}))
    assert read_tables([cell()], tmp_path) == {}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: "group\nchoices\n", "it has no column env, seed, settings, variant"),
        (lambda text: text.rstrip("\n") + ",1\n", "line 2 does not have a value for each column"),
        (lambda text: text.rstrip("\n").rpartition(",")[0], "line 2 does not have a value for each column"),
        (lambda text: text.replace(",640,", ",nan,"), "line 2: env_steps is nan"),
        (lambda text: text.replace(",640,", ",many,"), "line 2: could not convert string to float: 'many'"),
    ],
)
def test_a_damaged_table_is_named_with_the_line(finished, tmp_path, damage, message):
    write_tables([cell()], {cell().name: finished[1]}, tmp_path)
    table = tmp_path / "runs.csv"
    table.write_text(damage(table.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(RunFolderError, match=rf"runs.csv cannot be read as a table of runs: .*{message}"):
        read_tables([cell()], tmp_path)


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        (
            "curves.csv",
            lambda lines: lines[:-1],
            r"curves.csv has 2 rows of .*seed-5, whose run had 3 evaluations.*Rest",
        ),
        ("curves.csv", lambda lines: lines[:1], r"curves.csv has 0 rows of .*seed-5, whose run had 3 evaluations"),
        ("curves.csv", lambda lines: [*lines, lines[-1]], r"curves.csv has 4 rows of .*seed-5, whose run had 3 eval"),
        ("runs.csv", lambda lines: [*lines, lines[-1]], r"runs.csv has 2 rows of .*seed-5. Keep the one that is right"),
    ],
)
def test_a_run_that_is_not_whole_in_the_tables_is_not_taken_for_one(finished, tmp_path, table, change, message):
    write_tables([cell()], {cell().name: finished[1]}, tmp_path)
    file = tmp_path / table
    file.write_text("\n".join([*change(file.read_text(encoding="utf-8").splitlines()), ""]), encoding="utf-8")
    with pytest.raises(RunFolderError, match=message):
        read_summaries(Study(cells=(cell(),)), tmp_path)


@pytest.mark.parametrize(("table", "column"), [("runs.csv", "best_score"), ("curves.csv", "score_mean")])
def test_rows_without_what_is_compared_are_named(finished, tmp_path, table, column):
    study = Study(
        cells=(cell(),),
        design=StudyDesign(
            metrics={"point-gather": Measure("best_score", "score")},
            curves={"point-gather": Measure("score_mean", "score")},
        ),
    )
    write_tables([cell()], {cell().name: finished[1]}, tmp_path)
    assert list(read_summaries(study, tmp_path)) == [cell().name]
    text = (tmp_path / table).read_text(encoding="utf-8")
    place = text.splitlines()[0].split(",").index(column)
    *before, last = text.splitlines()
    values = last.split(",")
    values[place] = ""
    (tmp_path / table).write_text("\n".join([*before, ",".join(values)]) + "\n", encoding="utf-8")
    with pytest.raises(
        RunFolderError, match=rf"{table} has no {column} for {cell().name}\. Remove the rows of this run"
    ):
        read_summaries(study, tmp_path)


# All cells.


@pytest.fixture
def in_this_process(monkeypatch):
    """Let a study work here: its processes have their tests in tests/e2e, and take their time to start."""
    for processes in ("ProcessesBackend", "OneCoreBackend"):
        monkeypatch.setattr(running, processes, lambda factory, _: SerialBackend(factory))
    monkeypatch.setattr(running.signal, "pthread_sigmask", lambda *_: None)


def test_a_cell_that_fails_is_named_and_stops_only_what_begins_with_it(tmp_path, finished, in_this_process):
    bad, good = cell("bad", settings=FAILING), cell()
    follower = cell("follower", primitive=bad)
    study = Study(cells=(follower, good, bad), episodes=3)
    outcomes = {outcome.cell.name: outcome for outcome in run_study(study, tmp_path, num_workers=2)}
    assert list(outcomes) == [bad.name, follower.name, good.name]
    assert "noise_table_size is 3" in outcomes[bad.name].error
    assert outcomes[follower.name].error == f"not run: it begins with the primitive of {bad.name}, which failed."
    assert without_seconds(outcomes[good.name].summary) == without_seconds(finished[1])
    assert list(read_summaries(study, tmp_path)) == [good.name]


def test_a_study_whose_time_is_over_stops_and_goes_on_as_if_it_had_not(
    tmp_path, finished, in_this_process, monkeypatch
):
    monkeypatch.setattr(running, "time", lambda: 1000.0)
    follower = cell("follower", primitive=cell(), settings={**TINY, "freeze_primitive": True})
    study = Study(cells=(cell(), follower), episodes=3)
    outcomes = list(run_study(study, tmp_path, num_workers=1, until=1000.0))
    assert [(outcome.cell.name, outcome.summary, outcome.error) for outcome in outcomes] == [
        (cell().name, None, ""),
        (follower.name, None, ""),
    ]
    assert not (tmp_path / cell().name).exists()
    (outcome,) = run_study(Study(cells=(cell(),)), tmp_path, num_workers=1, until=1000.001)
    assert outcome.summary is None  # stopped in the middle
    assert runs.state(tmp_path / cell().name, "last").generation < TINY["generations"]
    assert run_cell(cell(), tmp_path, 3, until=0) is None
    assert without_seconds(run_cell(cell(), tmp_path, 3)) == without_seconds(finished[1])


def test_a_run_with_a_time_limit_of_its_own_is_finished_when_it_is_over(tmp_path):
    limited = cell(settings={**TINY, "minutes": 1e-3, "generations": 100_000})
    assert 1 <= run_cell(limited, tmp_path, 3).row["generations"] < 100


@pytest.mark.parametrize("num_workers", [2, 0])  # 0 is for the backend to resolve: a cluster has cores of its own
def test_large_runs_have_all_workers_and_the_same_numbers(tmp_path, finished, num_workers):
    study = Study(cells=(cell(),), episodes=3, has_large_runs=True)
    (outcome,) = run_study(study, tmp_path, num_workers=num_workers)
    assert without_seconds(outcome.summary) == without_seconds(finished[1])
    assert RunFolder(tmp_path / cell().name).read_config().values["num_workers"] == num_workers


def test_an_error_nobody_expected_is_an_outcome_with_its_traceback(monkeypatch, tmp_path, in_this_process):
    def fail(*arguments, **options):
        raise ZeroDivisionError("nothing to divide by")

    monkeypatch.setattr(running, "run_cell", fail)
    ((number, outcome),) = running.StudyWorker(tmp_path, 3, math.inf).run(iter([(4, cell())]), 1)
    assert (number, outcome.summary) == (4, None)
    assert outcome.error.endswith("ZeroDivisionError: nothing to divide by\n")


def test_a_cell_at_which_workers_keep_dying_has_failed_and_the_others_are_run():
    cells = [cell(variant) for variant in ("a", "deadly", "b", "c", "d")]
    outcomes = list(running._run_side_by_side(partial(ProcessesBackend, MortalWorker, 2), cells))
    errors = {outcome.cell.variant: outcome.error for outcome in outcomes}
    assert len(outcomes) == len(cells)
    assert errors.pop("deadly").startswith("workers keep dying (killed by SIGKILL, exit code -9) on the same task")
    assert errors == dict.fromkeys("abcd", "done")
    assert sum("died (exit code -9)" in event for outcome in outcomes for event in outcome.events) >= 3


@pytest.mark.parametrize(("num_workers", "keeps_to_a_core"), [(2, False), (3, True), (4, True), (0, True)])
def test_each_run_keeps_to_a_core_if_the_study_has_all(
    monkeypatch, tmp_path, in_this_process, num_workers, keeps_to_a_core
):
    one_core, used = running.OneCoreBackend, []

    def backend(*words):
        used.append(words)
        return one_core(*words)

    monkeypatch.setattr(running, "OneCoreBackend", backend)
    for module in ("shes.studies.running", "shes.runs.sections"):
        monkeypatch.setattr(f"{module}.num_cores", lambda: 3)
    study = Study(cells=(cell(),), episodes=2)
    assert all(outcome.summary for outcome in run_study(study, tmp_path, num_workers=num_workers))
    assert bool(used) == keeps_to_a_core


def test_a_transferred_primitive_comes_from_its_cell_wherever_the_study_lies(tmp_path, monkeypatch, in_this_process):
    source = cell("base", env="point-flagrun", group="transfer")
    frozen = cell("frozen", primitive=source, settings={**TINY, "freeze_primitive": True})
    study = Study(cells=(frozen, source), episodes=3)
    assert [outcome.error for outcome in run_study(study, tmp_path / "a", num_workers=2)] == ["", ""]
    one = runs.state(tmp_path / "a" / source.name, "best").levels[0]
    other = runs.state(tmp_path / "a" / frozen.name, "last").levels[1]
    assert (one.name, one.theta.tobytes()) == (other.name, other.theta.tobytes())
    found = read_summaries(study, tmp_path / "a")
    trained, curve = found[source.name], found[frozen.name].curve
    assert {row["primitive_env_steps"] for row in curve} == {trained.row["env_steps"]}
    assert {row["primitive_seconds"] for row in curve} == {trained.row["seconds"]}
    assert {row["primitive_seconds"] for row in trained.curve} == {None}
    (tmp_path / "a").rename(tmp_path / "b")
    monkeypatch.chdir(tmp_path)
    assert list(run_study(study, tmp_path / "b", num_workers=2)) == []
    (tmp_path / "b" / frozen.name / "summary.json").unlink()
    assert [outcome.error for outcome in run_study(study, tmp_path / "b", num_workers=2)] == [""]


# The ablation.


def test_a_study_goes_on_from_its_tables_alone(tmp_path, in_this_process):
    trained = cell(env="point-flagrun", group="transfer", settings={**TINY})
    begun = cell(group="transfer", variant="frozen", primitive=trained, settings={**TINY, "freeze_primitive": True})
    study = Study(cells=(trained, cell(), begun), episodes=2)
    first, second = tmp_path / "first", tmp_path / "second"
    assert all(outcome.summary for outcome in run_study(study, first, num_workers=1))
    whole = read_summaries(study, first)
    second.mkdir()
    write_tables(study.ordered(), {name: found for name, found in whole.items() if name != begun.name}, second)
    outcomes = list(run_study(study, second, num_workers=1))
    # The primitive is trained again: what begins with it needs more than its row.
    assert [outcome.cell.name for outcome in outcomes] == [trained.name, begun.name]
    again = read_summaries(study, second)
    assert {name: without_seconds(found) for name, found in again.items()} == {
        name: without_seconds(found) for name, found in whole.items()
    }
    assert not list(run_study(study, second, num_workers=1))


def test_a_row_does_not_stand_for_a_primitive_that_is_not_finished(tmp_path, in_this_process):
    trained = cell(env="point-flagrun", group="transfer")
    followers = [
        cell(group="transfer", variant=name, primitive=trained, settings={**TINY, "freeze_primitive": frozen})
        for name, frozen in (("frozen", True), ("unfrozen", False))
    ]
    study = Study(cells=(trained, *followers), episodes=2)
    first, second = tmp_path / "first", tmp_path / "second"
    assert all(outcome.summary for outcome in run_study(study, first, num_workers=1))
    whole = read_summaries(study, first)
    second.mkdir()
    write_tables(study.ordered(), {name: whole[name] for name in (trained.name, followers[0].name)}, second)
    training.start_run(cell_config(trained, second).having(minutes=1e-9), second / trained.name)  # stopped at once
    left = cells_left(study, second)
    assert [some.name for some in left] == [trained.name, followers[1].name]
    said, outcomes = [], run_study(study, second, num_workers=1)
    for _ in with_progress(study, outcomes, [some.name for some in left], 1, said.append):
        pass
    assert len(said) == 1 + len(left)
    again = read_summaries(study, second)
    assert {name: without_seconds(found) for name, found in again.items()} == {
        name: without_seconds(found) for name, found in whole.items()
    }


def test_rows_of_other_cells_stay_in_the_tables(finished, tmp_path):
    others = [cell(seed=9), cell(settings={**TINY, "sigma": 0.3})]
    summaries = {
        some.name: replace(finished[1], row={**finished[1].row, **some.identity}, curve=tuple(
            {**point, **some.identity} for point in finished[1].curve))
        for some in others
    }  # fmt: skip
    for some in others:
        write_tables([some], summaries, tmp_path)
    write_tables([cell(), others[0]], {}, tmp_path)  # neither is finished: a run is made again, or its folder is
    for some in others:
        assert read_tables([some], tmp_path) == {some.name: summaries[some.name]}
    assert len(rows(tmp_path / "runs.csv")) == 2


@pytest.fixture
def as_if_run(monkeypatch):
    """Let study ablation have one cell, and nothing be run or drawn; return the results that would be drawn."""
    seen = {}
    study = Study(cells=(cell(),), episodes=3)
    monkeypatch.setitem(STUDIES, "ablation", lambda *_: study)
    monkeypatch.setattr("shes.studies.experiment.run_study", lambda *_, **__: (each for each in ()))
    monkeypatch.setattr("shes.studies.experiment._write_results", lambda *given: (seen.update(given[3]) or {}, []))
    return seen


@pytest.mark.parametrize(("table", "keep"), [("curves.csv", 0), ("curves.csv", 1), ("curves.csv", -1), ("runs.csv", 1)])
def test_tables_that_lost_rows_are_written_again_from_the_folders(finished, tmp_path, as_if_run, table, keep):
    shutil.copytree(finished[0] / cell().name, tmp_path / cell().name)
    experiment("ablation", out=tmp_path)
    text = (tmp_path / table).read_text(encoding="utf-8")
    (tmp_path / table).write_text("".join(text.splitlines(keepends=True)[:keep]), encoding="utf-8")
    experiment("ablation", out=tmp_path)
    assert (tmp_path / table).read_text(encoding="utf-8") == text


def test_figures_and_comparisons_are_those_of_the_tables(finished, tmp_path, as_if_run):
    shutil.copytree(finished[0] / cell().name, tmp_path / cell().name)
    experiment("ablation", out=tmp_path)  # after a crash before the tables were written
    assert as_if_run[cell().name].row["env_steps"] == finished[1].row["env_steps"]
    text = (tmp_path / "runs.csv").read_text(encoding="utf-8")
    (tmp_path / "runs.csv").write_text(text.replace(f",{finished[1].row['env_steps']},", ",7,"), encoding="utf-8")
    experiment("ablation", out=tmp_path)
    assert as_if_run[cell().name].row["env_steps"] == 7


def test_a_run_whose_progress_was_lost_is_named(finished, tmp_path):
    run = shutil.copytree(finished[0] / cell().name, tmp_path / cell().name)
    (run / "summary.json").unlink()
    (run / "progress.csv").write_text("", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"no rows in progress\.csv\. Remove the folder"):
        run_cell(cell(), tmp_path, 3)
    lines = (finished[0] / cell().name / "progress.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (run / "progress.csv").write_text(lines[0] + lines[-1], encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"no generation before that of evaluation 1, \d+\. Remove"):
        run_cell(cell(), tmp_path, 3)


def test_a_table_that_does_not_say_of_which_settings_it_is_is_refused_and_kept(finished, tmp_path):
    text = "group,variant,env,seed\nchoices,base,point-gather,5\n"
    (tmp_path / "runs.csv").write_text(text, encoding="utf-8")
    for use in (lambda: read_tables([cell()], tmp_path), lambda: write_tables([cell()], {}, tmp_path)):
        with pytest.raises(RunFolderError, match=r"runs\.csv cannot be .*no column settings.*Move it elsewhere"):
            use()
    assert (tmp_path / "runs.csv").read_text(encoding="utf-8") == text


def test_the_tables_of_the_ablation_in_results_are_whole():
    assert cells_left(ablation(), Path(__file__).parents[2] / "results" / "ablation") == []


@pytest.mark.parametrize(("first", "second"), [([1.0, 2.0, 4.0], [3.0, 7.0, 9.0, 9.5]), ([1.0, 1.0], [1.0, 1.0])])
def test_the_permutation_test_of_few_values_is_exact(first, second):
    values, least = [*first, *second], abs(np.mean(first) - np.mean(second)) - 1e-12
    splits = list(itertools.combinations(range(len(values)), len(first)))
    found = [
        abs(np.mean([values[i] for i in split]) - np.mean([v for i, v in enumerate(values) if i not in split]))
        for split in splits
    ]
    expected = sum(each >= least for each in found) / len(splits)
    assert permutation_test(np.array(first), np.array(second)) == pytest.approx(expected)


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("scale", ablations.SCALES)
def test_every_cell_of_a_study_has_settings_that_are_allowed(name, scale, tmp_path):
    check_study(MADE[name](scale, seeds=1), tmp_path)  # a seed changes nothing else


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("scale", ablations.SCALES)
def test_the_design_of_a_study_names_what_there_is(name, scale):
    study = MADE[name](scale, seeds=1)
    design, places = study.design, {(found.env, found.group, found.variant) for found in study.cells}
    variants = {place[1:] for place in places}
    assert {group for group, _ in variants} == set(design.groups)
    assert design.base in variants
    assert set(design.metrics) == set(design.curves) <= {env for env, _, _ in places}
    assert set(design.labels) <= {variant for _, variant in variants}
    assert {place for pair in design.paired for place in pair} <= variants
    assert set(design.slower) <= {variant for _, variant in variants}
    for figure in design.figures:
        groups = figure.groups if isinstance(figure, Curves) else (figure.group,)
        assert set(groups) <= set(design.groups)
        for panel in getattr(figure, "panels", ()):
            assert {(panel.env, curve.group, curve.variant) for curve in panel.curves} <= places
        for setting in getattr(figure, "settings", ()):
            assert {(figure.group, sweep_name(setting, factor)) for factor in figure.factors} <= variants


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_refuses_sizes_it_does_not_have(name):
    with pytest.raises(UnknownNameError, match="unknown scale 'large'"):
        STUDIES[name]("large")
    with pytest.raises(ConfigError, match=r"seeds must be a whole number between 1 and 1000, got 0\."):
        STUDIES[name](seeds=0)
    with pytest.raises(ConfigError, match=r"got 1000000000000\. Set --seeds\."):  # no list of them is made
        STUDIES[name](seeds=10**12)


def test_the_ablation_has_the_seeds_that_were_asked_for():
    counts = {}
    for found in ablation().cells:
        counts.setdefault((found.env, found.group, found.variant), set()).add(found.seed)
    for (_, group, _), seeds in counts.items():
        assert seeds == set(range(1, 6 if group == "sweep" else 11))
    for env in ablations.ENVS:
        groups = [group for where, group, _ in counts if where == env]
        assert [groups.count(group) for group in ("choices", "sweep", "transfer")] == [10, 20, 3]
    assert sorted(variant for _, group, variant in counts if group == "horizon") == ["horizon-1000", "horizon-500"]
    assert {found.seed for found in ablation(seeds=3).cells} == {1, 2, 3}


def test_every_variant_of_the_ablation_makes_as_many_environment_steps_as_the_base():
    for scale, tolerance in (("laptop", 0.07), ("smoke", 0.3)):  # whole generations, and few of them
        steps = {}
        for found in ablation(scale).cells:
            factors = (found.settings[name] for name in ("generations", "population_size", "horizon"))
            steps[found.env, found.variant] = math.prod(factors)
        for (env, variant), number in steps.items():
            assert number == pytest.approx(steps[env, "base"], rel=tolerance), (scale, env, variant)


def test_an_experiment_of_scale_laptop_takes_at_most_ten_hours_on_two_cores_without_hiro():
    for name, make in MADE.items():
        study = make()
        seconds = forecast(study, 2)
        assert sum(seconds[found.name] for found in study.cells if found.variant != "hiro") <= 10 * 3600, name
        # Of a step of HIRO, which comes with updates, the speed is its own.
        for found in (each for each in study.cells if each.variant == "hiro"):
            alone = found.settings["env_steps"] / study.design.slower["hiro"]
            assert alone / 2 < seconds[found.name] < alone
    # Runs with as many workers as they say, one after another.
    for number in (1, 2):
        timed = forecast(MADE["fig4"](), 8)[f"point-push/workers/published-{number}/seed-1"]
        cell = next(found for found in MADE["fig4"]().cells if found.name.endswith("published-1/seed-1"))
        steps = sum(cell_steps(replace(cell, env="point-push"), MADE["fig4"]().episodes))
        assert timed == pytest.approx(steps / STEPS_PER_S["point"] / number)
    # A generation of figure 6 on each of three cores alone, then on two and on three workers.
    study = MADE["fig6"]()
    for found in study.cells:
        alone = cell_steps(found, 0)[0] / STEPS_PER_S["ant"]
        assert forecast(study, 3)[found.name] == pytest.approx(alone * (3 + 1 / 2 + 1 / 3))


@pytest.mark.parametrize(
    ("name", "part", "words"),
    [
        ("fig4", "", "on 2 cores (steps a second and core: point: 35,000, ant: 10,000)"),  # its own workers
        ("fig4", "pieces-1", "on 1 core (steps"),
        ("fig6", "", "on 9 cores (steps a second and core: ant: 10,000)"),
        ("fig3", "hiro", "HIRO, small: 1,000)"),
        ("fig3", "point-gather/steps/views", "(steps a second and core: point: 35,000)"),
    ],
)
def test_the_forecast_is_of_what_is_left_and_names_its_speeds(name, part, words):
    study, said = MADE[name](), []
    left = [found.name for found in study.cells if part in found.name]
    assert not list(with_progress(study, (), left, 9, said.append))
    assert words in said[0]


def test_a_sweep_multiplies_the_base_and_rounds_whole_numbers():
    cells = {(found.env, found.variant): found.settings for found in ablation(seeds=1).cells}
    base = cells["point-maze", "base"]
    for name in ablations.SWEPT:
        for factor in ablations.FACTORS:
            value = cells["point-maze", sweep_name(name, factor)][name]
            assert type(value) is type(base[name])
            assert value == pytest.approx(factor * base[name], abs=2 if isinstance(value, int) else 1e-9)
    assert all(settings["population_size"] % 4 == 0 for settings in cells.values())


def test_some_groups_alone_come_with_the_base_and_the_primitives():
    study = choose(ablation("smoke"), ["horizon", "transfer"])
    found = {(c.env, c.group, c.variant) for c in study.cells}
    both = [(env, group, name) for env in ablations.ENVS for group, name in (("choices", "base"),)]
    transfers = [(env, "transfer", name) for env in ablations.ENVS for name in ("scratch", "frozen", "unfrozen")]
    longer = [("point-maze", "horizon", f"horizon-{steps}") for steps in ablations.SCALES["smoke"].horizons]
    assert found == {*both, *transfers, *longer, ("point-flagrun", "transfer", "base")}
    assert choose(ablation("smoke"), None) == ablation("smoke")
    assert {(c.env, c.group) for c in choose(ablation("smoke"), ["point-maze", "choices"]).cells} == {
        ("point-maze", "choices")
    }
    alone = choose(STUDIES["fig5"]("smoke"), ["ant-push"])
    assert {c.env for c in alone.cells} == {"ant-push", "ant-flagrun"}
    assert {c.group for c in alone.cells} == {"methods", "transfer"}
    with pytest.raises(UnknownNameError, match=r"unknown group or environment 'choice'\. Did you mean 'choices'"):
        choose(ablation("smoke"), ["choice"])


@pytest.mark.parametrize("name", STUDIES)
def test_the_command_offers_the_studies_the_scales_and_the_groups_there_are(name):
    offered = get_type_hints(experiment)
    assert get_args(offered["name"]) == tuple(STUDIES)
    assert set(get_args(offered["scale"])) == set(papers.SCALES)
    assert set(ablations.SCALES) == set(walker_study.SCALES) == set(papers.SCALES) - {"paper"}
    help_of_only = " ".join(experiment.__doc__.split()).partition("only: ")[2]
    assert f"{name}: {', '.join(sorted(MADE[name]('smoke').design.groups))}" in help_of_only


# The learning study.


def test_every_run_of_the_learning_study_ends_after_as_many_steps_and_evaluates_as_often():
    for scale, size in walker_study.SCALES.items():
        for found in learning(scale, seeds=1).cells:
            config = cell_config(found, Path("study"))
            assert config.run.env_steps == size.env_steps
            between = config.evaluation.evaluation_interval * generation_steps(config)
            assert size.evaluation_steps / 2 <= between <= 2 * size.evaluation_steps, found.name
            # Episodes that end early make more generations of as many steps: they must not come to their end first.
            assert config.run.generations * config.evolution.population_size > size.env_steps


def test_the_learning_study_has_its_variants_in_words_and_five_seeds():
    study, groups = learning(), walker_study.variants()
    assert {group: len(found) for group, found in groups.items()} == {
        "pieces": 11,
        "form": 8,
        "alternatives": 8,
        "sweep": 8,
        "grid": 12,
    }
    assert all(variant.words for found in groups.values() for variant in found.values())
    assert len(study.cells) == 5 * 47
    assert {found.seed for found in study.cells} == {1, 2, 3, 4, 5}
    assert {found.seed for found in learning(seeds=2).cells} == {1, 2}


def test_a_piece_left_out_changes_that_piece_alone():
    configs = {found.variant: cell_config(found, Path("study")).values for found in learning(seeds=1).cells}
    base = configs["base"]
    changed = {
        variant: {name for name, value in config.items() if value != base[name]} - {"evaluation_interval"}
        for variant, config in configs.items()
    }
    assert changed["base"] == set()
    assert changed["no-view"] == {"primitive_view", "symmetry"}
    assert changed["episodes"] == {"primitive_estimate", "population_size"}
    assert changed["sigma-decay"] == {"sigma_schedule", "sigma_end", "schedule_generations"}
    single = [
        name for name in changed if name not in ("base", "no-view", "sigma-decay", *walker_study.variants()["grid"])
    ]
    single = [name for name in single if not name.startswith(("episodes", "form"))]
    assert {name: len(changed[name]) for name in single} == dict.fromkeys(single, 1)
    parts = ("no-view", "glorot-output", "no-clock", "episodes", "goal-angle", "fall-price-0")
    assert changed["form"] == set().union(*(changed[name] for name in parts))
    assert changed["form-egocentric"] == changed["form"] - {"primitive_view"}
    assert changed["form-dihedral"] == changed["form"] - {"primitive_view", "symmetry"}
    assert changed["form-interval"] == changed["form"] - changed["episodes"]
    added = {"zero": "output_weights", "clock": "clock_frequency", "goal": "goal_encoding", "fall-price": "fall_price"}
    for name, setting in added.items():
        assert changed[f"form-{name}"] == changed["form"] - {setting}
    assert changed["sigma-x0.5-learning-rate-x2"] == {"sigma", "learning_rate"}
    assert configs["population-size-x2-sigma-x0.5"]["population_size"] == 2 * base["population_size"]
    assert configs["population-size-x2-sigma-x0.5"]["sigma"] == base["sigma"] / 2
    assert configs["sigma-decay"]["sigma_end"] == pytest.approx(base["sigma"] / 5)
    assert configs["sigma-decay"]["schedule_generations"] == 11


def test_a_cell_ends_with_its_environment_steps_and_is_not_gone_on_with(tmp_path, monkeypatch):
    (some,) = (found for found in learning("smoke", seeds=1).cells if found.variant == "base")
    summary = run_cell(some, tmp_path, 2)
    assert 2_000 <= summary.row["env_steps"] < 2_400
    assert summary.curve[-1]["episode_steps_mean"] <= 50
    (tmp_path / some.name / "summary.json").unlink()
    monkeypatch.setattr(running, "resume_run", None)
    assert run_cell(some, tmp_path, 2) == summary


def test_steps_of_a_generation_count_branches_and_whole_episodes():
    def steps(env, **settings):
        some = cell(env=env, settings={**TINY, "controller_interval": 10, **settings})
        return generation_steps(cell_config(some, Path("study")))

    interval = {"primitive_estimate": "interval", "intervals": 3, "primitive_view": "proprioception"}
    assert steps("point-flagrun") == 8 * 20
    assert steps("point-flagrun", **interval) == 8 * 3 * 10
    assert steps("point-gather", **interval, primitive_population_size=6) == 8 * 20 + 6 * 3 * 10


# Statistics.


def test_the_permutation_test_agrees_with_the_exact_number():
    low, high = np.arange(5.0), np.arange(5.0, 10.0)
    assert permutation_test(low, high) == pytest.approx(2 / 252, abs=0.003)  # both ways to part all from all
    mixed = permutation_test(np.array([1.0, 4.0, 6.0]), np.array([2.0, 3.0, 9.0]))
    # Of the 20 ways to take 3 of the 6 values, 16 have sums at least 1.5 away from 12.5.
    assert mixed == pytest.approx(16 / 20, abs=0.02)


def test_without_scipy_a_study_does_not_begin_and_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "scipy", None)
    for start in (check_scipy, lambda: check_study(ablation("smoke"), tmp_path / "out")):
        with pytest.raises(
            MissingExtraError, match=r"a study need SciPy \(.*\)\. Install it: pip install 'shes\[study\]'"
        ):
            start()


def test_without_a_package_or_a_backend_no_run_of_a_study_begins(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "shes.baselines.learning", None)
    monkeypatch.setitem(sys.modules, "ray", None)
    study = STUDIES["fig3"]("smoke", 1)
    for part, backend, error, words in (
        (study, "processes", MissingExtraError, "--algorithm hiro needs JAX"),
        (choose(study, ["steps"]), "ray", MissingExtraError, "--backend ray needs Ray"),
        (choose(study, ["steps"]), "rays", UnknownNameError, "'rays'"),
    ):
        with pytest.raises(error, match=words):
            next(run_study(part, tmp_path / "out", num_workers=1, backend=backend))
    assert not (tmp_path / "out").exists()


def test_the_permutation_test_is_symmetric_seeded_and_never_zero():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=10), rng.normal(size=10) + 20
    assert permutation_test(first, second) == permutation_test(first, second)
    assert permutation_test(first, second) == pytest.approx(permutation_test(second, first), abs=1e-3)
    assert permutation_test(first, second) > 0
    assert permutation_test(np.full(5, 0.1), np.full(10, 0.1)) == 1


@pytest.mark.parametrize(
    ("first", "second", "p", "share"),
    [
        ([1, 2, 3], [4, 5, 6], 2 / 20, 1.0),  # the most extreme of the 20 orders, and its opposite
        ([4, 5, 6], [1, 2, 3], 2 / 20, 0.0),
        ([1, 2, 5], [3, 4, 6], 8 / 20, 7 / 9),  # U = 2: 4 of the 20 orders have U <= 2
        (range(10), range(10, 20), 2 / math.comb(20, 10), 1.0),
        ([1, 1], [1, 1], 1.0, 0.5),
        ([0] * 5, [1] * 5, 2 / 252, 1.0),  # ties within the samples: 2 of the 252 divisions part all from all
        ([0, 1], [1, 2], 4 / 6, 7 / 8),  # a tie between them: U = 0.5, as in 2 of the 6 divisions, and none is less
        ([1, 2, 2, 3], [2, 3, 3], 2 * 10 / 35, 9 / 12),  # U = 3: 10 of the 35 divisions have U <= 3
        ([0] * 10, [1] * 10, 2 / math.comb(20, 10), 1.0),
        # The four ones of all are in one sample, as in this share of the divisions.
        ([0] * 10, [0] * 6 + [1] * 4, 2 * math.comb(10, 4) / math.comb(20, 4), 0.7),
        # The normal approximation. U = 0 of a mean of 1800, with a variance of 3600 / 12 *
        # (121 - 2 * (60^3 - 60) / (120 * 119)), and 0.5 for continuity.
        ([0] * 60, [1] * 60, math.erfc(1799.5 / math.sqrt(2 * 3600 / 12 * (121 - 431_880 / 14_280))), 1.0),
    ],
)
def test_mann_whitney_and_superiority_of_orders_counted_by_hand(first, second, p, share):
    first, second = np.array(first, float), np.array(second, float)
    assert superiority(first, second) == pytest.approx(share)
    assert mann_whitney(first, second) == pytest.approx(p)


def test_mann_whitney_agrees_with_scipy():
    rng = np.random.default_rng(0)
    for sizes in ((3, 8), (10, 10), (50, 50)):
        first, second = (rng.normal(shift, size=size) for shift, size in zip((0, 0.5), sizes, strict=True))
        found = check_scipy().mannwhitneyu(first, second, method="exact").pvalue
        assert mann_whitney(first, second) == pytest.approx(found)
        assert mann_whitney(second, first) == pytest.approx(found)
    every = check_scipy().PermutationMethod(n_resamples=1000)
    for _ in range(20):
        first, second = rng.integers(4, size=(2, 5)).astype(float)
        found = check_scipy().mannwhitneyu(first, second, method=every).pvalue
        assert mann_whitney(first, second) == pytest.approx(found)


def test_mann_whitney_agrees_with_the_help_of_r():
    # The example of R's wilcox.test has the one-sided p 0.1272. Source: Hollander and Wolfe (1973), page 69.
    first = np.array([0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46])
    second = np.array([1.15, 0.88, 0.90, 0.74, 1.21])
    assert mann_whitney(first, second) == pytest.approx(2 * 0.1272, abs=1e-4)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([100, 0, 1, 2, 6], 3.0),  # of 1, 2, 6: one value is left out at each end
        ([81, 64, 49, 36, 25, 16, 9, 4, 1, 0], 139 / 6),  # of 4, 9, 16, 25, 36, 49: two at each end
    ],
)
def test_the_interquartile_mean_of_5_and_10_values_agrees_with_a_hand_value(values, expected):
    assert interquartile_mean(np.array(values, float))[0] == pytest.approx(expected)


def test_the_interquartile_mean_ignores_a_quarter_at_each_end():
    values = np.array([-1000.0, 1, 2, 3, 4, 5, 6, 1e6])
    mean, low, high = interquartile_mean(values)
    assert mean == 3.5  # of 2, 3, 4, 5
    assert low < mean < high
    # Percentiles of resampled means, drawn here by other means.
    values = np.linspace(0, 1, 9) ** 2
    drawn = np.random.default_rng(1).choice(values, (20_000, 9))
    expected = np.percentile(np.sort(drawn, axis=1)[:, 2:7].mean(axis=1), [2.5, 97.5])
    assert interquartile_mean(values)[1:] == pytest.approx(expected, abs=0.02)
    assert interquartile_mean(np.array([0.3])) == (0.3, 0.3, 0.3)
    assert interquartile_mean(np.full(5, 0.1)) == pytest.approx((0.1, 0.1, 0.1))


def test_holm_corrects_as_the_textbook_does():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([0.02]) == [0.02]
    assert holm([]) == []
    assert holm([0.5, None, 0.02]) == [0.5, None, 0.04]


def test_variants_are_compared_with_the_base_of_their_task_and_corrected_within_their_group():
    study = ablation()

    def score(found):
        is_worse = found.variant in ("mirrored-none", "frozen") and found.env == "point-maze"
        return 0.1 * (found.seed % 5) - (2 if is_worse else 0)

    summaries = {
        found.name: CellResults(row={**found.identity, study.design.metrics[found.env].column: score(found)}, curve=())
        for found in study.cells
        if found.env in ablations.ENVS
    }
    found = {(c.env, c.group, c.variant, c.against): c for c in compare(study, summaries)}
    assert {c.against_group for c in found.values()} == {None, "choices", "transfer", "horizon"}
    base = found["point-maze", "choices", "base", None]
    assert (base.seeds, base.score_mean, base.p, base.p_holm) == (10, pytest.approx(0.2), None, None)
    assert (base.mann_whitney_p, base.superiority) == (None, None)
    assert base.score_low < 0.2 < base.score_high
    worse = found["point-maze", "choices", "mirrored-none", "base"]
    assert worse.difference == pytest.approx(-2)
    assert (worse.p, worse.p_holm) == (pytest.approx(1e-4, rel=2), pytest.approx(9 * worse.p))
    assert (worse.mann_whitney_u, worse.superiority) == (0, 0)
    assert worse.mann_whitney_p == pytest.approx(2 / math.comb(20, 10))
    unfrozen = found["point-maze", "transfer", "unfrozen", "frozen"]
    assert (unfrozen.mann_whitney_u, unfrozen.superiority) == (100, 1)
    assert found["point-gather", "choices", "mirrored-none", "base"].p_holm == 1
    assert unfrozen.difference == pytest.approx(2)
    assert found["point-maze", "horizon", "horizon-1000", "horizon-500"].p == 1
    assert all(c.env in ablations.ENVS for c in found.values())


def test_what_is_not_finished_is_not_compared():
    study = ablation("smoke")
    some = next(found for found in study.cells if found.variant == "sigma-x2")
    summaries = {some.name: CellResults(row={**some.identity, study.design.metrics[some.env].column: 1.0}, curve=())}
    (found,) = compare(study, summaries)  # there is no base yet
    assert (found.variant, found.against, found.p) == ("sigma-x2", None, None)
    assert compare(study, {}) == []


def test_no_variant_of_the_learning_study_is_its_base_or_another_one():
    """A preset must not bring back what a variant leaves out."""
    cells = learning(seeds=1).cells
    runs = {cell.variant: make_config(cell.env, cell.preset, cell.settings).numbers() for cell in cells}
    numbers = [{name: value for name, value in run.items() if name != "env_steps"} for run in runs.values()]
    assert all(one != other for one, other in itertools.combinations(numbers, 2))
    without_clock, without_view = runs["no-clock"], runs["no-view"]
    assert (without_clock["clock_frequency"], without_view["symmetry"]) == (None, "none")
