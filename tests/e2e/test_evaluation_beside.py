"""Evaluation beside the next generation: no result is lost, and rows and checkpoints are those of a run without it."""

import numpy as np
import pytest

import shes
from shes.algorithms.evolution.strategies import EvolutionAlgorithm
from shes.errors import WorkerError
from shes.runs import session
from shes.runs.checkpoint import load_checkpoint
from shes.runs.tables import read_csv
from tests.e2e import runs

PROCESSES = {"backend": "processes", "num_workers": 2, "evaluation_interval": 1}


def last(path):
    """Return the last checkpoint of a run."""
    return load_checkpoint(path / "checkpoints" / "last.npz")


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """A run that evaluates every generation, one thing after the other."""
    return runs.train_tiny(tmp_path_factory.mktemp("serial") / "run", evaluation_interval=1)


class Order:
    """A listener that notes what it hears, and ends the run after the evaluation of a generation, or breaks it."""

    def __init__(self, stop=None, error=None):
        self.heard, self.stop, self.error = [], stop, error

    def on_generation(self, row):
        self.heard.append(("generation", row["generation"]))
        if row["generation"] == self.error:
            raise WorkerError("broken")

    def on_evaluation(self, row):
        self.heard.append(("evaluation", row["generation"]))
        return row["generation"] == self.stop


def test_a_run_has_the_numbers_of_one_that_evaluates_at_once_and_rows_in_order(tmp_path, serial):
    listener = Order()
    path = runs.train_tiny(tmp_path / "run", listener=listener, **PROCESSES)
    assert runs.differences(serial, path) == []
    assert read_csv(path / "evaluation.csv")["generation"] == [1, 2, 3, 4]
    kinds = [(kind, generation) for generation in (1, 2, 3, 4) for kind in ("generation", "evaluation")]
    assert listener.heard == kinds
    assert not last(path).owes_evaluation


def test_states_that_share_memory_are_evaluated_and_written_before_the_next_generation(tmp_path, serial, monkeypatch):
    path, made = tmp_path / "run", EvolutionAlgorithm.run

    def run(algorithm, state, backend):
        for report in made(algorithm, state, backend):
            if report.state.generation > 1:  # it was made after all of the generation before
                before = report.state.generation - 1
                assert (last(path).generation, last(path).owes_evaluation) == (before, False)
                assert read_csv(path / "evaluation.csv")["generation"][-1] == before
            yield report

    monkeypatch.setattr(EvolutionAlgorithm, "run", run)
    monkeypatch.setattr(EvolutionAlgorithm, "shares_memory", True)
    runs.train_tiny(path, **PROCESSES)
    assert runs.differences(serial, path) == []


def test_an_evaluation_that_ends_the_run_drops_the_generation_beside_it(tmp_path, serial):
    run = shes.train("point-gather", out=tmp_path / "run", listener=Order(stop=2), **{**runs.TINY, **PROCESSES})
    assert run.generation == 2
    assert read_csv(run.path / "progress.csv")["generation"] == [1, 2]
    shes.resume(run.path, generations=4)
    assert runs.differences(serial, run.path) == []


def test_an_error_loses_no_evaluation(tmp_path, serial, monkeypatch):
    with pytest.raises(WorkerError, match="broken"):
        runs.train_tiny(tmp_path / "run", listener=Order(error=3), **PROCESSES)
    path = tmp_path / "run"
    assert read_csv(path / "evaluation.csv")["generation"] == [1, 2]
    assert (last(path).generation, last(path).owes_evaluation) == (3, True)
    shes.resume(path)
    assert runs.differences(serial, path) == []


def test_a_run_that_ended_without_its_last_evaluation_is_resumed_for_it(tmp_path, serial):
    with pytest.raises(WorkerError, match="broken"):
        runs.train_tiny(tmp_path / "run", listener=Order(error=4), **PROCESSES)
    path = tmp_path / "run"
    assert last(path).owes_evaluation
    assert shes.resume(path).generation == 4
    assert runs.differences(serial, path) == []


def test_an_owed_row_that_was_written_already_is_written_once(tmp_path, serial):
    with pytest.raises(WorkerError, match="broken"):
        runs.train_tiny(tmp_path / "run", listener=Order(error=3), **PROCESSES)
    path = tmp_path / "run"
    lines = (serial / "evaluation.csv").read_text().splitlines(keepends=True)
    with (path / "evaluation.csv").open("a") as file:
        file.write(lines[3])  # the row of generation 3: a kill between it and the next checkpoint leaves it there
    shes.resume(path)
    assert read_csv(path / "evaluation.csv")["generation"] == [1, 2, 3, 4]
    assert runs.differences(serial, path) == []


def test_an_evaluation_that_has_ended_is_recorded_when_ctrl_c_stops_the_run(tmp_path, monkeypatch):
    class Evaluation(session.EvaluationBeside):
        """One that is done as soon as it has begun."""

        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.result()
            self.is_held = True

        @property
        def is_done(self):
            held, self.is_held = self.is_held, False
            return not held

    def interrupt(row):
        if row["generation"] == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(session, "EvaluationBeside", Evaluation)
    with pytest.raises(KeyboardInterrupt):
        runs.train_tiny(tmp_path / "run", listener=interrupt, **{**PROCESSES, "backend": "serial"})
    found = last(tmp_path / "run")
    assert (found.generation, found.owes_evaluation) == (2, True)
    assert np.isfinite(found.best.score)
