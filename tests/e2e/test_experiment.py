"""`shes experiment`: small studies to their end, stopped and gone on with; flags that make no sense."""

import csv
import json
import math
import os
import re
import shutil
import signal
from pathlib import Path

import pytest

from shes.cli import main
from shes.envs.registry import ENVIRONMENTS
from shes.studies import experiment
from shes.studies.named_studies import STUDIES
from shes.studies.study import Study
from shes.studies.study_tables import Cell
from tests.e2e import runs

TINY = {name: value for name, value in runs.TINY.items() if name not in ("preset", "seed", "backend")}
SOME = ("--scale", "smoke", "--only", "horizon", "transfer", "--workers", "2")


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


TIMES = ("seconds", "primitive_seconds", "hours", "primitive_hours")


def without_times(rows):
    return [{name: value for name, value in row.items() if name not in TIMES} for row in rows]


@pytest.fixture
def small(monkeypatch):
    """Let the ablation be two seeds of two variants, of which one cannot be run at all."""

    design = STUDIES["ablation"]("smoke").design

    def make(scale="laptop", seeds=None):
        kinds = {"base": TINY, "mirrored-none": {**TINY, "mirrored": "none"}}
        cells = [
            Cell(group="choices", variant=variant, env="point-gather", seed=seed, settings=settings, preset="smoke")
            for variant, settings in kinds.items()
            for seed in (1, 2)
        ]
        broken = {**TINY, "noise_table_size": 3}
        cells.append(
            Cell(group="choices", variant="goal-vector", env="point-gather", seed=1, settings=broken, preset="smoke")
        )
        cells = tuple(cells[: 4 if scale == "smoke" else 5])
        return Study(cells=cells, episodes=2, design=design)

    monkeypatch.setitem(STUDIES, "ablation", make)


@pytest.mark.extras
def test_the_command_tells_what_is_ahead_what_is_done_and_what_came_of_it(small, tmp_path, capsys):
    words = ["experiment", "ablation", "--scale", "smoke", "--out", str(tmp_path), "--workers", "2"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("4 runs, 3,760 environment steps. About 0 s on 2 cores (steps a second and core: point: 35")
    assert "[1/4] point-gather/choices/base/seed-1: score " in out
    assert "[4/4] point-gather/choices/mirrored-none/seed-2: score " in out
    assert "no mirroring" in out
    assert [row["seed"] for row in table(tmp_path / "runs.csv")] == ["1", "1", "2", "2"]
    assert len(table(tmp_path / "curves.csv")) == 4 * 3
    assert [row["against"] for row in table(tmp_path / "comparison.csv")] == ["", "base"]
    assert (tmp_path / "choices.png").stat().st_size > 10_000
    before = (tmp_path / "runs.csv").read_bytes()

    # Again, now with a cell that fails: what is done is not done again, and the others count.
    assert main(["experiment", "ablation", "--out", str(tmp_path), "--json"]) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert (found["cells"], list(found["failed"])) == (5, ["point-gather/choices/goal-vector/seed-1"])
    assert "point-gather/choices/goal-vector/seed-1 failed: noise_table_size is 3" in err
    assert "1 of 5 runs failed" in err
    assert (tmp_path / "runs.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["learning", "--only", "choices"], r"unknown group or environment 'choices'\. Did you mean 'pieces'"),
        (
            ["ablation", "--only", "sweeps"],
            r"unknown group or environment 'sweeps'\. Did you mean 'sweep'\? Known: sweep, choices, hor",
        ),
        (["fig3", "--backend", "ray"], "--backend ray is for runs that have all workers: those of scale paper"),
        (["fig3", "--no-run"], "a has no finished run of fig3 at scale laptop, and no row of one in runs.csv"),
        (["learning", "--only"], "--only needs at least one of pieces, form, alternatives, sweep, grid, ant-flagrun"),
        (
            ["ablation", "--only"],
            "--only needs at least one of choices, sweep, transfer, horizon, point-flagrun, point-gather, point-maze",
        ),
        (["ablation", "--seeds", "0"], r"seeds must be a whole number between 1 and 1000, got 0\. Set --seeds\."),
        (["ablation", "--scale", "paper"], r"unknown scale 'paper'\. Known: laptop, smoke\. Set --scale\."),
        (["fig3", "--scale", "smoke", "--budget", "0"], r"budget must be a positive number, got 0\.0\. Set --budget\."),
        (["ablation", "--workers", "-1"], r"workers must be a whole number of at least 0, got -1\. Set --workers\."),
    ],
)
def test_flags_that_make_no_sense_are_refused(words, message, tmp_path, capsys):
    assert main(["experiment", words[0], "--out", str(tmp_path / "a"), *words[1:]]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert re.search(message, err)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ablatoin"], r"unknown name 'ablatoin'\. Did you mean 'ablation'"),
        (
            ["ablation", "--scale", "large"],
            r"Error parsing --scale: unknown name 'large'\. Known: laptop, paper, smoke",
        ),
        (["ablation", "--seeds", "many"], r"Error parsing --seeds: .*'many'"),
    ],
)
def test_words_that_are_no_value_of_their_flag_are_refused(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["experiment", words[0], "--out", str(tmp_path / "a"), *words[1:]]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert re.search(message, err)
    assert not (tmp_path / "a").exists()


def test_budget_workers_backend_and_parts_arrive_at_the_runs(monkeypatch, tmp_path, capsys):
    heard = []

    def run(study, out, **options):
        heard.append(({cell.env for cell in study.cells}, out, options))
        yield from ()

    monkeypatch.setattr(experiment, "run_study", run)
    monkeypatch.setattr(experiment, "time", lambda: 1000.0)
    flags = ["--budget", "2", "--workers", "3", "--backend", "serial", "--only", "point-maze", "point-push"]
    assert main(["experiment", "fig4", "--scale", "smoke", "--out", str(tmp_path), *flags, "--json"]) == 0
    options = {"num_workers": 3, "backend": "serial", "until": 1000 + 2 * 3600}
    assert heard == [({"point-maze", "point-push"}, tmp_path, options)]
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["cells"] == 8


def test_what_is_there_is_drawn_without_a_run_and_nothing_is_lost(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(experiment, "run_study", lambda *_, **__: pytest.fail("runs"))
    kept = Path(__file__).parents[2] / "results" / "ablation"
    lines = {name: (kept / name).read_text().splitlines(keepends=True) for name in ("runs.csv", "curves.csv")}
    settings = lines["runs.csv"][0].strip().split(",").index("settings")
    gone, *rows = csv.reader(lines["runs.csv"][1:])
    others = [[*row[:settings], "of another study", *row[settings + 1 :]] for row in rows[-1:]]
    with (tmp_path / "runs.csv").open("w", newline="") as file:
        file.write(lines["runs.csv"][0])
        csv.writer(file, lineterminator="\n").writerows([*rows[:-1], *others])
    (tmp_path / "curves.csv").write_text("".join(lines["curves.csv"]))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["experiment", "ablation", "--out", str(tmp_path), "--no-run", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    missing = {f"{row[2]}/{row[0]}/{row[1]}/seed-{row[3]}" for row in (gone, rows[-1])}
    assert set(found["missing"]) == missing
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.name in before} == before
    assert len(table(tmp_path / "comparison.csv")) == COMPARISONS["ablation"]
    assert all(Path(path).stat().st_size for path in found["figures"])


def test_a_folder_that_is_a_file_or_a_run_is_refused(tmp_path, tiny_run, capsys):
    (tmp_path / "file").touch()
    for out in ("file", "file/below"):
        assert main(["experiment", "ablation", "--scale", "smoke", "--out", str(tmp_path / out)]) == 2
        assert "file is a file, not a folder" in capsys.readouterr().err
    assert main(["experiment", "ablation", "--scale", "smoke", "--out", str(tiny_run)]) == 2
    assert "is a run folder" in capsys.readouterr().err


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Folder of a part of the smoke ablation that nothing happened to."""
    out = tmp_path_factory.mktemp("undisturbed") / "study"
    code, printed, err = runs.run("experiment", "ablation", *SOME, "--out", out)
    assert (code, err) == (0, ""), printed
    return out


def go_on(out, undisturbed):
    """Fail if the study that goes on has other numbers than one that nothing happened to."""
    code, printed, err = runs.run("experiment", "ablation", *SOME, "--out", out)
    assert (code, err) == (0, ""), printed
    for name in ("runs.csv", "curves.csv", "comparison.csv"):
        assert without_times(table(out / name)) == without_times(table(undisturbed / name))
    for row in table(out / "runs.csv"):
        path = f"{row['env']}/{row['group']}/{row['variant']}/seed-{row['seed']}"
        different = [name for name in runs.differences(out / path, undisturbed / path) if "settings" not in name]
        assert different == []  # settings hold the path of the primitive


def start_and_wait(out):
    """Start the study, wait until some cells are done; return the process and its workers."""
    process = runs.start("experiment", "ablation", *SOME, "--out", out)
    runs.wait_until(lambda: len(list(out.glob("*/*/*/*/summary.json"))) >= 4 or process.poll() is not None, "4 cells")
    workers = runs.workers_of(process.pid)
    assert process.poll() is None
    return process, workers


@pytest.mark.slow
@pytest.mark.extras
def test_ctrl_c_ends_the_study_and_the_same_command_goes_on(tmp_path, undisturbed):
    process, workers = start_and_wait(tmp_path / "study")
    os.killpg(process.pid, signal.SIGINT)
    code, out, err = runs.finish(process)
    assert code == 130
    assert out.endswith("Stopped; finished runs are kept. Continue with the same command.\n")
    assert err == "Interrupted.\n"
    runs.assert_gone(process.pid, workers)
    go_on(tmp_path / "study", undisturbed)


@pytest.mark.slow
@pytest.mark.extras
def test_kill_9_of_the_study_leaves_no_worker_and_the_same_command_goes_on(tmp_path, undisturbed):
    process, workers = start_and_wait(tmp_path / "study")
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    runs.assert_gone(process.pid, workers)
    go_on(tmp_path / "study", undisturbed)


@pytest.mark.slow
@pytest.mark.extras
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_worker_is_told_and_changes_nothing(tmp_path, undisturbed, number):
    process, workers = start_and_wait(tmp_path / "study")

    def is_gone():  # a SIGTERM that comes while the files of a finished run are written changes nothing
        try:
            os.kill(workers[0], number)
        except ProcessLookupError:
            return True
        return False

    runs.wait_until(is_gone, "the worker is gone")
    code, out, err = runs.finish(process)
    assert (code, err) == (0, "")
    assert f"worker {workers[0]} died" in out
    go_on(tmp_path / "study", undisturbed)


# fig4 has worker processes in every run, fig6 in every measurement.
@pytest.mark.slow
@pytest.mark.extras
@pytest.mark.parametrize("name", ["fig4", "fig6"])
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_experiment_of_many_workers_leaves_none_and_the_same_command_goes_on(tmp_path, name, stop):
    words = ("experiment", name, "--scale", "smoke", "--seeds", 1, "--only", "point-maze", "--workers", 2)
    process = runs.start(*words, "--out", tmp_path)
    done = f"point-maze/*/*{'2' if name == 'fig4' else ''}/seed-1/summary.json"
    seen = set()

    def has_workers():
        seen.update(runs.workers_of(process.pid))
        return (list(tmp_path.glob(done)) and runs.workers_of(process.pid)) or process.poll() is not None

    runs.wait_until(has_workers, "a run with workers")
    assert process.poll() is None
    os.killpg(process.pid, stop)
    process.communicate()
    runs.assert_gone(process.pid, list(seen))
    before = {path: path.read_bytes() for path in tmp_path.glob("*/*/*/*/summary.json")}
    code, printed, err = runs.run(*words, "--out", tmp_path)
    assert (code, err) == (0, ""), printed
    assert len(table(tmp_path / "runs.csv")) == {"fig4": 4, "fig6": 3}[name]
    assert all(path.read_bytes() == content for path, content in before.items())


# A base, 9 choices, 20 of the sweep, 3 of transfer and their pairs, on both tasks; 2 horizons and their pair.
# A base, 10 pieces, 8 variants of the form, 8 alternatives, 12 of the grid, 8 of the sweep, and 8 pairs.
COMPARISONS = {"ablation": 2 * (1 + 9 + 20 + 3 + 3) + 3, "learning": 1 + 10 + 8 + 8 + 12 + 8 + 8}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", COMPARISONS)
def test_a_whole_study_of_scale_smoke_has_its_tables_and_figures(tmp_path, name):
    process = runs.start("experiment", name, "--scale", "smoke", "--out", tmp_path, "--json")
    out, err = process.communicate(timeout=500)
    study = STUDIES[name]("smoke")
    assert (process.returncode, err) == (0, "")
    found = json.loads(out)
    assert [path.rpartition("/")[2] for path in found["figures"]] == [figure.file for figure in study.design.figures]
    assert found["cells"] == len(table(tmp_path / "runs.csv")) == len(study.cells)
    assert found["failed"] == {}
    assert len(found["comparisons"]) == len(table(tmp_path / "comparison.csv")) == COMPARISONS[name]


@pytest.fixture(scope="module")
def of_the_paper(tmp_path_factory):
    """The folder that the experiments of the paper share."""
    return tmp_path_factory.mktemp("paper")


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(name, marks=pytest.mark.extras) for name in ("fig4", "fig5", "fig6")),
        *(pytest.param(name, marks=pytest.mark.hiro) for name in ("table1", "fig3")),
    ],
)
def test_an_experiment_of_the_paper_has_tables_from_which_anyone_draws_its_figures(name, of_the_paper, tmp_path):
    words = ("experiment", name, "--scale", "smoke", "--workers", "2", "--out")
    process = runs.start(*words, of_the_paper, "--json")
    out, err = process.communicate(timeout=500)
    assert (process.returncode, err) == (0, "")
    study, found = STUDIES[name]("smoke"), json.loads(out.splitlines()[-1])
    assert (found["cells"], found["failed"], found["stopped"]) == (len(study.cells), {}, [])
    drawn = {f"{Path(figure.file).stem}.{form}" for figure in study.design.figures for form in ("png", "svg")}
    assert {Path(path).name for path in found["figures"]} == drawn
    comparisons = table(of_the_paper / f"{name}.csv")
    assert len(comparisons) == len(found["comparisons"])
    assert {row["variant"] for row in comparisons} == set(study.design.labels)
    for row in comparisons:
        filled = ["seeds", "score_mean", "score_iqm_low", "score_iqm_high", "hours", "hardware", "versions"]
        filled += [] if name == "fig6" else ["success_mean"]
        if row["against"]:
            is_tested = row["seeds"] != "1"  # at this scale the ant has one seed
            tests = ["p_holm", "mann_whitney_u", "mann_whitney_p", "superiority"] if is_tested else ["difference"]
            # Of this scale's other pairs one run ends where the other one, or its primitive, begins. Over time, that
            # depends on the machine.
            is_long = (row["group"], row["variant"], row["against"]) == ("methods", "pieces", "published")
            is_long &= row["env"] not in ("ant-maze", "ant-push")  # whose first search has more steps than these runs
            tests += ["steps_span", "steps_score", "steps_score_against"] if is_long else []
            tests += ["steps_p", "steps_p_holm"] if is_long and is_tested else []
            filled += ["ratio", "ratio_low"] if name in ("fig4", "fig6") else tests
        assert all(row[column] for column in filled), row

    for file in of_the_paper.glob("*.csv"):
        shutil.copy(file, tmp_path)
    assert main([*words, str(tmp_path)]) == 0
    assert not any(path.is_dir() for path in tmp_path.iterdir())  # nothing was run again
    again, before = (
        {path.name: path.read_bytes() for path in folder.glob(f"{name}*.[ps][nv]g")}
        for folder in (tmp_path, of_the_paper)
    )
    assert again == before
    assert {path.rpartition(".")[-1] for path in again} == {"png", "svg"}


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("env", [env for env in ENVIRONMENTS if env.startswith("ant-")])
def test_a_whole_generation_of_preset_paper(tmp_path, env):
    process = runs.start("train", env, "--preset", "paper", "--generations", "1", "--out", tmp_path / "run")
    _, err = process.communicate(timeout=3500)
    assert (process.returncode, err) == (0, "")
    (row,) = table(tmp_path / "run" / "progress.csv")
    policies = 256 if env == "ant-flagrun" else 1000
    assert policies * 5 <= int(row["env_steps"]) <= policies * 5 * 500
    assert all(math.isfinite(float(row[column])) for column in row if column.endswith("return_mean"))
    assert runs.state(tmp_path / "run").generation == 1
