"""Folders of runs: seeds and sweeps, one after another, resumed as a whole."""

import itertools
import json
import shutil

import pytest

from shes.cli import main
from shes.errors import DivergenceError, PolicyError, RunFolderError, WorkerError
from shes.runs.folder import RunFolder
from shes.runs.progress_display import ProgressDisplay
from shes.runs.runs_folder import RunsFolder, find_runs, read_sweep, vary
from tests.e2e import runs
from tests.messages import raises

SEVERAL = {name: value for name, value in runs.TINY.items() if name != "seed"}


def train(path, *words, **settings):
    """Return the exit code of `shes train` with tiny settings."""
    flags = runs.flags(**{**SEVERAL, **settings}, out=path)
    return main(["train", "point-gather", *flags, *words])


def generations(path):
    """Return the finished generations of every run below `path`, by place."""
    return {str(run.path.relative_to(path)): run.load("last").generation for run in find_runs(path)}


def refused(capsys, *words):
    """Return the message with which a command line is refused."""
    assert main([str(word) for word in words]) == 2
    return " ".join(capsys.readouterr().err.split())


def test_a_sweep_has_a_run_for_every_combination_and_seed(tmp_path, capsys):
    swept = read_sweep(["sigma=0.02,0.5", "controller_interval=7,9"])
    found = vary("point-gather", "smoke", {}, [1, 2], swept)
    assert list(found) == [
        f"sigma-{sigma}_controller-interval-{interval}/seed-{seed}"
        for sigma, interval, seed in itertools.product(("0.02", "0.5"), (7, 9), (1, 2))
    ]
    config = found["sigma-0.5_controller-interval-7/seed-2"]
    assert (config.evolution.sigma, config.hierarchy.controller_interval, config.run.seed) == (0.5, 7, 2)
    assert train(tmp_path / "all", "--sweep", "sigma=0.02,0.5", generations=1) == 0
    assert "Done: 2 runs" in capsys.readouterr().out
    assert generations(tmp_path / "all") == {"sigma-0.02/seed-1": 1, "sigma-0.5/seed-1": 1}


def test_a_folder_that_was_stopped_goes_on_with_what_is_missing(tmp_path, tiny_run, monkeypatch, capsys):
    path, words, heard = tmp_path / "all", ("--seed", "4", "5", "6"), []

    def interrupt(display, row):
        heard.append(row["generation"])
        if len(heard) in (6, 9):  # in the second run, in the third run
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ProgressDisplay, "on_generation", interrupt)
        assert train(path, *words) == 130
        assert generations(path) == {"seed-4": 4, "seed-5": 2}
        assert f"Go on: shes resume {path}\n" in capsys.readouterr().out
        first = (path / "seed-4" / "log.txt").read_bytes()
        assert train(path, *words) == 130  # the same command goes on, too
        assert generations(path) == {"seed-4": 4, "seed-5": 4, "seed-6": 1}
    assert main(["resume", str(path)]) == 0
    assert (path / "seed-4" / "log.txt").read_bytes() == first
    assert generations(path) == {"seed-4": 4, "seed-5": 4, "seed-6": 4}
    assert RunFolder(path / "seed-6").read_config().run.seed == 6
    assert runs.differences(tiny_run, path / "seed-5") == []  # each seed is an ordinary run
    assert train(path, *words) == 0  # nothing is left
    assert "all 3 runs of" in refused(capsys, "resume", path)


def test_a_folder_goes_on_with_more_generations_and_seeds(tmp_path, capsys):
    path = tmp_path / "all"
    assert train(path, "--seed", "4", "5", generations=1) == 0
    assert train(path, "--seed", "5", "6", generations=2) == 0
    assert generations(path) == {"seed-4": 1, "seed-5": 2, "seed-6": 2}
    assert "seed 7 is given twice" in refused(capsys, "train", "point-gather", "--seed", "7", "7")
    assert main(["resume", str(path), "--generations", "5"]) == 0
    assert set(generations(path).values()) == {5}
    runs.change_json(path / "runs.json", lambda record: record["runs"]["seed-4"]["run"].update(generations=3))
    assert refused(capsys, "resume", path).endswith(f"have ended. To go on: shes resume {path} --generations 10")
    ended = {"minutes": 1e-9, "generations": 6}
    runs.change_json(path / "runs.json", lambda record: [each["run"].update(ended) for each in record["runs"].values()])
    for table in path.glob("*/progress.csv"):  # as if each run had taken an hour: minutes are those of each
        *rows, last = table.read_text().splitlines()
        cells = last.split(",")
        table.write_text("\n".join([*rows, ",".join([*cells[:2], "3600.0", *cells[3:]])]) + "\n")
    assert f"have ended. To go on: shes resume {path} --minutes" in refused(capsys, "resume", path)
    assert main(["resume", str(path), "--minutes", "10"]) == 0
    assert set(generations(path).values()) == {6}


def test_a_run_that_fails_does_not_stop_the_others(tmp_path, monkeypatch, capsys):
    errors = {"seed-4": PolicyError, "seed-5": WorkerError, "seed-6": DivergenceError}

    def fail(display, row):
        if error := errors.get(display.path.name):
            raise error("the policy returned NaN")

    with monkeypatch.context() as patch:
        patch.setattr(ProgressDisplay, "on_generation", fail)
        assert train(tmp_path / "all", "--seed", "4", "5", "6", "7", generations=2) == 1
    said = capsys.readouterr().err
    assert all(f"{name} failed: the policy returned NaN" in said for name in errors)
    assert "3 of 4 runs failed" in said
    assert generations(tmp_path / "all") == {**dict.fromkeys(errors, 1), "seed-7": 2}
    assert main(["resume", str(tmp_path / "all")]) == 0
    assert set(generations(tmp_path / "all").values()) == {2}


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """Folder of two runs that have begun. Not to be changed."""
    path = tmp_path_factory.mktemp("begun") / "all"
    assert train(path, "--seed", "4", "5", minutes=1e-9) == 0
    return path


def test_a_folder_in_use_or_of_other_settings_is_refused(begun, capsys):
    record = (begun / "runs.json").read_bytes()
    again = ["train", "point-gather", *runs.flags(**SEVERAL)]
    more = ("--out", begun, "--seed", "4", "5", "6")
    other = "has run seed-4 with other settings: sigma is 0.07, not 0.5"
    assert other in refused(capsys, *again, *more, "--sigma", "0.5")
    with RunFolder(begun).lock():
        assert "is in use" in refused(capsys, *again, *more)
    assert (begun / "runs.json").read_bytes() == record
    assert "already holds a run" in refused(capsys, *again, "--out", begun / "seed-4", "--seed", "4", "5")
    assert "is a file" in refused(capsys, *again, "--out", begun / "runs.json", "--seed", "4", "5")


def test_a_damaged_record_is_one_clear_error(tmp_path, begun):
    record, file = json.loads((begun / "runs.json").read_text()), tmp_path / "runs.json"
    for damaged, message in (
        (record | {"format": 9}, "has no runs in format 1"),
        (record | {"runs": {}}, "has no runs in format 1"),
        ([record], "cannot be read"),
    ):
        file.write_text(json.dumps(damaged))
        with raises(RunFolderError, f"{message} ... Restore it from a copy"):
            RunsFolder.open(tmp_path)


def test_values_are_read_as_their_setting_needs():
    assert read_sweep(["sigma=0.02, 5e-1", "workers=1,2", "primitive-sigma=none,0.1"]) == {
        "sigma": {"0.02": 0.02, "5e-1": 0.5},
        "num_workers": {"1": 1, "2": 2},
        "primitive_sigma": {"none": None, "0.1": 0.1},
    }
    assert read_sweep(['env_kwargs={"a":3},{}']) == {"env_kwargs": {'{"a":3}': {"a": 3}, "{}": {}}}
    assert read_sweep(["hidden=none,64x32", "freeze_primitive=true,false", "algorithm=es,shes"]) == {
        "hidden": {"none": (), "64x32": (64, 32)},
        "freeze_primitive": {"true": True, "false": False},
        "algorithm": {"es": "es", "shes": "shes"},
    }


def test_everything_is_refused_before_there_is_a_folder(tmp_path, capsys):
    base = ["train", "point-gather", *runs.flags(**SEVERAL, out=tmp_path / "all")]
    assert "population_size" in refused(capsys, *base[:4], "--out", tmp_path / "all", "--sweep", "population_size=8,7")
    many = [f"--sweep={name}={','.join(map(str, range(1, 33)))}" for name in ("sigma", "learning_rate")]
    assert "these are 1,024 runs; at most 1,000 are allowed" in refused(capsys, *base, *many)
    assert "seed needs at least one value" in refused(capsys, *base, "--seed")
    assert "sigma is both given and swept" in refused(capsys, *base, "--sigma", "1", "--sweep", "sigma=1,2")
    for words in ((), ("--seed", "1", "2")):
        assert "out must be the path of a folder, got ''" in refused(capsys, *base[:-2], *words, "--out", "")
    assert "seed must be" in refused(capsys, *base, "--seed", "1", "-2")
    for name, message in (("population-size", "GB are free. Lower"), ("noise-table-size", "noise_table_size is ")):
        sweep = ["--sweep", f"{name}=8,{10**15}", "--workers", "1"]
        assert message in refused(capsys, *base[:4], "--out", tmp_path / "all", *sweep)
    assert list(tmp_path.iterdir()) == []


def test_places_differ_even_where_values_cannot_be_file_names():
    found = vary("point-gather", "smoke", {}, [1], {"sigma": {"0.1": 0.1, "0.1 ": 0.2}})
    assert len(found) == 2
    assert all("/" not in name.partition("/")[2] and " " not in name for name in found)


def test_runs_are_found_in_natural_order_and_one_is_named(tmp_path, tiny_run):
    folder = tmp_path / "runs" / "point-gather" / "sigma-0.5"
    for name in ("seed-10", "seed-9", "seed-1", "too/deep"):
        shutil.copytree(tiny_run, folder / name)
    (tmp_path / "model").mkdir()
    for place in (tmp_path, tmp_path / "model"):
        (place / ".lock").touch()  # as of a study
    (tmp_path / "model" / "config.json").write_text("{}")  # of another program
    assert [run.path.name for run in find_runs(tmp_path)] == ["seed-1", "seed-9", "seed-10"]
    assert [run.path for run in find_runs(tiny_run)] == [tiny_run]
    with pytest.raises(RunFolderError):
        find_runs(tmp_path / "model" / "config.json")
    with raises(RunFolderError, f"is no run folder. Give one below it (3), e.g. {folder}/seed-1"):
        RunFolder.open(tmp_path)
