"""The same numbers for any number of workers, any chunk size, any backend."""

import shutil

import numpy as np
import pytest

import shes
from tests.contracts.variants import VARIANTS
from tests.e2e import runs

SETTINGS = {
    "preset": "smoke",
    "seed": 7,
    "population_size": 20,
    "hidden": (8,),
    "horizon": 60,
    "evaluation_horizon": 40,
    "generations": 3,
    "evaluation_interval": 2,
    "evaluation_episodes": 4,
    "keep_checkpoints": 2,
    "noise_table_size": 1_000_000,
}


def by_command(path, **settings):
    """Train in a process of its own."""
    code, out, err = runs.run("train", "point-gather", *runs.flags(**{**SETTINGS, **settings}, out=path))
    assert (code, err) == (0, ""), out
    return path


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return a function that returns a run of the serial backend with that many episodes per policy."""
    made = {}

    def make(episodes):
        if episodes not in made:
            path = tmp_path_factory.mktemp("reference") / "run"
            made[episodes] = by_command(path, episodes_per_policy=episodes, backend="serial")
        return made[episodes]

    return make


# With 3 workers, 20 policies leave 2 over, which go out episode by episode.
@pytest.mark.parametrize(("episodes", "workers", "chunk_size"), [(1, 2, 7), (1, 3, 0), (3, 1, 1), (3, 2, 3), (3, 3, 7)])
def test_workers_and_chunks_change_no_number(reference, tmp_path, episodes, workers, chunk_size):
    path = by_command(tmp_path / "run", episodes_per_policy=episodes, workers=workers, chunk_size=chunk_size)
    assert runs.differences(reference(episodes), path) == []


@pytest.mark.extras
@pytest.mark.timeout(600)
@pytest.mark.parametrize("chunk_size", [0, 1, 3, 7])
@pytest.mark.parametrize("workers", [0, 1, 2, 3], ids=["serial", "1", "2", "3"])
@pytest.mark.parametrize("episodes", [1, 3])
def test_every_spread_gives_the_same_numbers(reference, tmp_path, episodes, workers, chunk_size):
    spread = {"workers": workers} if workers else {"backend": "serial"}
    path = by_command(tmp_path / "run", episodes_per_policy=episodes, chunk_size=chunk_size, **spread)
    assert runs.differences(reference(episodes), path) == []


@pytest.mark.extras
def test_the_ant_has_the_same_numbers_on_one_and_three_workers(tmp_path):
    paths = []
    for workers in (1, 3):
        path = tmp_path / str(workers)
        settings = {**SETTINGS, "episodes_per_policy": 3, "workers": workers, "out": path}
        code, out, err = runs.run("train", "ant-gather", *runs.flags(**settings))
        assert (code, err) == (0, ""), out
        paths.append(path)
    assert runs.differences(*paths) == []


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(each, id="-".join(each), marks=[] if each == ("point-push", "hiro") else [pytest.mark.slow])
        for each in VARIANTS
    ],
)
def test_neither_workers_nor_a_resume_change_the_numbers_of_any_task(tmp_path, variant):
    settings = {"spec": variant.spec, "population_size": 12, "evaluation_interval": 1, "keep_checkpoints": 1}
    one = runs.train_tiny(tmp_path / "one", variant.name, **settings, generations=2)
    two = tmp_path / "two"
    runs.train_tiny(two, variant.name, **settings, generations=1, backend="processes", num_workers=2, chunk_size=3)
    shes.resume(two, generations=2)
    assert runs.differences(one, two) == []
    assert "progress.csv/env_steps" in runs.numbers(one)


def test_the_comparison_sees_every_kind_of_number(tiny_run):
    names = runs.numbers(tiny_run)
    files = {name.split("/")[0] for name in names}
    assert files == {
        "best.npz",
        "evaluation.csv",
        "generation_000000.npz",
        "generation_000002.npz",
        "generation_000004.npz",
        "last.npz",
        "progress.csv",
    }
    assert {"last.npz/controller/theta", "last.npz/primitive/adam_second", "progress.csv/env_steps"} <= names.keys()
    assert not any(name.endswith("_s") for name in names)
    assert runs.differences(tiny_run, tiny_run) == []


def test_the_comparison_detects_another_seed(tiny_run, tmp_path):
    other = runs.train_tiny(tmp_path / "run", seed=6)
    assert {"last.npz/seed", "last.npz/controller/theta", "progress.csv/primitive_return_mean"} <= set(
        runs.differences(tiny_run, other)
    )


def test_the_comparison_detects_one_bit_in_one_array(tiny_run, tmp_path):
    path = shutil.copytree(tiny_run, tmp_path / "run")
    last = path / "checkpoints" / "last.npz"
    with np.load(last) as file:
        arrays = dict(file)
    arrays["primitive/theta"].view(np.int32)[-1] ^= 1
    np.savez(last, **arrays)
    assert runs.differences(tiny_run, path) == ["last.npz/primitive/theta"]


def test_the_comparison_detects_a_digit_in_a_table(tiny_run, tmp_path):
    path = shutil.copytree(tiny_run, tmp_path / "run")
    text = (path / "evaluation.csv").read_text().rstrip()
    (path / "evaluation.csv").write_text(text[:-1] + "9\n")
    assert runs.differences(tiny_run, path) == ["evaluation.csv/diverged_episodes"]


def test_the_comparison_detects_a_missing_checkpoint_and_a_missing_row(tiny_run, tmp_path):
    path = shutil.copytree(tiny_run, tmp_path / "run")
    (path / "checkpoints" / "generation_000002.npz").unlink()
    assert all(name.startswith("generation_000002.npz/") for name in runs.differences(tiny_run, path))
    assert runs.differences(tiny_run, path)
    rows = (path / "progress.csv").read_text().splitlines(keepends=True)
    (path / "progress.csv").write_text("".join(rows[:-1]))
    assert "progress.csv/generation" in runs.differences(tiny_run, path)
