"""Summaries and tables of finished runs: kept, read back, refused if they are of other settings or damaged."""

import pytest

from experiments.results import RunResults, read_results, read_summary, read_tables, write_summary, write_tables
from shes.errors import RunFolderError
from tests.experiments.tiny import experiment, run
from tests.messages import raises

ONE = experiment(run())


def results_of(each, **row):
    curve = [{**each.identity, "env_steps": 10.0 * step, "score_mean": step / 3} for step in range(3)]
    return RunResults(row={**each.identity, "best_score": 0.1, "commit": "a; b", **row}, curve=curve)


def test_a_summary_is_read_back_unless_settings_differ(tmp_path):
    results = results_of(run(), best_success=None)
    assert read_summary(run(), tmp_path) is None
    write_summary(run(), tmp_path, results)
    assert read_summary(run(), tmp_path) == results
    assert run(seed=1, primitive=run("p", seed=1)).digest == run(seed=2, primitive=run("p", seed=2)).digest
    for other in (run(sigma=0.5), run(primitive=run("primitive"))):
        with raises(RunFolderError, "seed-5 holds results of other settings than run ... another --scale"):
            read_summary(other, tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", '{"row": {}}'])
def test_a_damaged_summary_says_what_to_do(tmp_path, text):
    write_summary(run(), tmp_path, results_of(run()))
    (tmp_path / run().name / "summary.json").write_text(text)
    with raises(RunFolderError, "summary.json cannot be read: ... Remove it to have it made again"):
        read_results(ONE, tmp_path)


def test_tables_are_read_back_if_they_are_of_the_same_settings(tmp_path):
    results = {run().name: results_of(run())}
    write_tables(ONE, results, tmp_path)
    found = read_results(ONE, tmp_path)
    assert found[run().name].row | results[run().name].row == found[run().name].row
    assert [row["score_mean"] for row in found[run().name].curve] == [0, 1 / 3, 2 / 3]
    for other in (run(sigma=0.5), run(seed=6), run("other"), run(primitive=run("source"))):
        members = (other,) if other.primitive is None else (other, other.primitive)
        assert read_tables(experiment(*members), tmp_path) == {}
    assert list(read_tables(experiment(run(sigma=0.5)), tmp_path, has_any_settings=True)) == [run().name]


def test_a_folder_takes_precedence_over_a_row(tmp_path):
    write_tables(ONE, {run().name: results_of(run())}, tmp_path)
    (tmp_path / run().name).mkdir(parents=True)  # of a run that is not finished
    assert read_results(ONE, tmp_path) == {}


def test_rows_of_other_runs_stay_and_the_same_are_replaced(tmp_path):
    other = run("other")
    for each, score in ((run(), 0.1), (other, 0.2), (run(), 0.3)):
        write_tables(experiment(each), {each.name: results_of(each, best_score=score)}, tmp_path)
    write_tables(ONE, {}, tmp_path)
    found = read_tables(experiment(run(), other), tmp_path)
    assert {name: each.row["best_score"] for name, each in found.items()} == {run().name: 0.3, other.name: 0.2}
    assert all(len(each.curve) == 3 for each in found.values())


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: "group\nchoices\n", "it has no column variant, env, seed, settings"),
        (lambda text: text.rstrip("\n").rpartition(",")[0], "a line does not have a value for each column"),
        (lambda text: text.replace(",0.1,", ",nan,"), "best_score is nan"),
        (lambda text: text.replace(",0.1,", ",many,"), "could not convert string to float: 'many'"),
    ],
)
def test_a_damaged_table_is_named_and_kept(tmp_path, damage, message):
    write_tables(ONE, {run().name: results_of(run())}, tmp_path)
    table = tmp_path / "runs.csv"
    table.write_text(text := damage(table.read_text()))
    for use in (lambda: read_tables(ONE, tmp_path), lambda: write_tables(ONE, {}, tmp_path)):
        with raises(RunFolderError, f"runs.csv ... {message} ... Move it elsewhere"):
            use()
    assert table.read_text() == text
